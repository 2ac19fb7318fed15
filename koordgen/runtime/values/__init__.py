"""Values of Koord programs, and functions that compute with values.

Owns: points, poses, grids, scans, containers, grid maps, geometry, size limits, the count of an event's turns.
Offers: value classes and functions to generated code, to the semantics, to planners, drivers and simulators.
Must not import: any other package.
"""
