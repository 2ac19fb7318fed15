"""Prover: checks that a program's invariants hold in every run, for any number of robots.

Owns: terms and solvers (`smt`), encoding of the IR (`encode`), proof obligations (`obligations`), verdicts (`report`).
Offers: `report.verdict.prove`.
Must not import: explore, audit, attack.
"""
