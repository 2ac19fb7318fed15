"""Motion: where the vehicle has to be.

Owns: reference trajectory, setpoints, return to the path, avoidance, yaw, landing places.
Offers: `motion.Motion`.
Must not import: `platform`.
"""
