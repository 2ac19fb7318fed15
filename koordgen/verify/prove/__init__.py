"""Prover: a program's invariants, for any number of robots.

Owns: terms and solvers (`smt`), encoding (`encode`), what is to be shown (`obligations`), verdicts (`report`).
Offers: `report.verdict.prove`.
Must not import: explore, audit, attack.
"""
