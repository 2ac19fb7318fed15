"""Path planning for cars: paths that a car can drive.

Owns: curves, lattice search, footprints and their collisions, lanes of other robots, reasons why there is no path.
Offers: `ask`, which planner processes import, and `avoidance`.
Must not import: `control`, `drive`, `platform`.
"""
