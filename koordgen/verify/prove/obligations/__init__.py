"""Proof obligations: the formulas that together imply that an invariant holds.

Owns: obligations of the mission's start, of each event, of the environment's step, of loops; their expected number.
Offers: `generate.obligations`.
Must not import: `report`.
"""
