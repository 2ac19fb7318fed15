"""Control of the car: computes speed and steering commands that follow a planned path.

Owns: MPC with its solver, path tracking, the navigator, state estimation, the braking check at the geofence, motor lag.
Offers: `navigator.Navigator`, `mpc.Mpc`.
Must not import: `drive`, `platform`.
"""
