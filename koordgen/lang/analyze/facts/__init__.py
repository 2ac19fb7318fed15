"""Facts: conditions known to hold at a program point, derived without running the program.

Owns: linear terms over integers, conditions passed on the path to a point, loops by induction.
Offers: all of its modules (`path`, `terms`, `decide`, `induction`, ...) to `rules` and to the walk.
Must not import: rules.
"""
