"""Audit: evaluates the properties of a program after every round, over the traces of a whole fleet.

Owns: trace files of several robots, histories, clock checks, results of properties, broken assumptions, pictures.
Offers: `judge`, `result`, `history`.
Must not import: explore, attack.
"""
