"""Audit: the generated properties, evaluated over the traces of a whole fleet after every round.

Owns: trace files of several robots, their histories, clocks, results of properties, broken assumptions, pictures.
Offers: `judge`, `result`, `history`.
Must not import: explore, attack.
"""
