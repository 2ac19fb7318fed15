"""Audit: evaluates a program's generated properties over the traces of a whole fleet.

The properties are evaluated after every round.

Owns: trace files of several robots, histories, clock checks, results of properties, broken assumptions, pictures.
Offers: `judge`, `result`, `history`.
Must not import: explore, attack.
"""
