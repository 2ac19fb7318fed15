"""Verification: what can be known of a program before, and after, it runs.

Owns: proofs, exploration, replay of traces, audit of fleets, attack on proofs.
Offers: one room for each; `prove` for any number of robots, `explore` for all runs of few.
Must not import: `experiment` or any room above it. `attack` must not import the prover's obligations.
"""
