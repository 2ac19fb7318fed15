"""Obligations: what has to be shown so that an invariant holds.

Owns: the mission's start, each event, the environment's step, loop invariants, how many obligations there are.
Offers: `generate.obligations`.
Must not import: `report`.
"""
