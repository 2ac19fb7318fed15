"""Proof obligations: formulas that together imply that an invariant holds in every run.

Owns: obligations of the mission's start, each event, the environment's step and loops; the expected number of
obligations.
Offers: `generate.obligations`.
Must not import: `report`.
"""
