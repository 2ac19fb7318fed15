"""Solvers of the car's MPC problem: a compiled C solver, and a CasADi solver if the C code cannot be compiled.

Owns: the model, the generated `mpc.c`, the fallback.
Offers: `compiled`, `fallback`, `problem`.
Must not import: any package of the car but `base`.
"""
