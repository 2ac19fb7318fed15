"""Analysis: facts that hold at a point of an event, decided without running it.

Owns: linear terms over integers, conditions on the way to a point, loops by induction.
Offers: `decide`, `facts`, `path` and their like to `check`.
Must not import: `check`.
"""
