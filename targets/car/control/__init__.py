"""Control: from a planned path to a speed and a steering angle.

Owns: MPC with its solver, tracking, the navigator, state estimation, the braking check at the fence, motor lag.
Offers: `navigator.Navigator`, `mpc.Mpc`.
Must not import: `drive`, `platform`.
"""
