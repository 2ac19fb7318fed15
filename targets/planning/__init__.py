"""Planning for all vehicles: paths around obstacles, in a process of its own.

Owns: rooms and their obstacles, planners, exact distances, the planner's process, what is told of no progress.
Offers: `process.Planning`, `world` and `room` to planners of users.
Must not import: any target.
"""
