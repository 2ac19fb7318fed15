"""Path planning for all vehicles: paths around obstacles, computed in a separate process.

Owns: free space and obstacles, planners, exact distances, the planner's process, detection of missing progress.
Offers: `process.Planning` to platforms; `world` and `room` to the planners that users write.
Must not import: any target.
"""
