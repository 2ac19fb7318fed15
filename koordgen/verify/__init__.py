"""Verification: analyses of a program before it runs, and of its runs afterwards.

Owns: proofs, explicit-state exploration, replay of traces, audit of fleets, attack on proofs.
Offers: one package for each. `prove` covers any number of robots, `explore` all runs of a small fleet.
Must not import: `experiment` or any package above it. `attack` must not import the prover's obligations.
"""
