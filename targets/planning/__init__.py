"""Path planning for all vehicles: paths around obstacles, computed in a separate process.

Owns: free space and obstacles, planners, exact distances, the planner's process, detection of missing progress.
Offers: `process.Planning`, `world` and `room` to planners of users.
Must not import: any target.
"""
