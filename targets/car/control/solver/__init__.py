"""Solver of the car's MPC: in C where it compiles, else by CasADi.

Owns: the model, the generated `mpc.c`, the fallback.
Offers: `compiled`, `fallback`, `problem`.
Must not import: any package of the car but `base`.
"""
