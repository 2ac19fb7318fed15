"""Values of Koord programs, and what can be computed from them.

Owns: points, poses, grids, scans, containers, grid maps, geometry, size limits, the steps that an event may take.
Offers: value classes and functions to generated code, to the semantics, to planners, drivers and simulators.
Must not import: any other package.
"""
