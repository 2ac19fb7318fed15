"""Motion control of the quad: computes the setpoints that it follows.

Owns: reference trajectory, setpoints, return to the path, obstacle avoidance, yaw, landing places.
Offers: `motion.Motion`.
Must not import: `platform`.
"""
