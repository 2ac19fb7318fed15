"""Facts: what holds at a point of an event, decided without running it.

Owns: linear terms over integers, conditions on the way to a point, loops by induction.
Offers: `path`, `terms`, `decide`, `induction` and their like to `rules` and to the walk.
Must not import: rules.
"""
