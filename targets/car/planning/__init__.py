"""Planning: ways that a car can drive.

Owns: curves, lattice search, footprints and their collisions, lanes of others, reasons why there is no way.
Offers: `ask`, which planner processes import, and `avoidance`.
Must not import: `control`, `drive`, `platform`.
"""
