"""Replicated shared memory: one robot's copy, and the protocol that keeps all copies equal.

Owns: the log of rounds, arbitration of transactions, views and their ballots, retransmission, dead-robot detection,
    rejoining.
Offers: `Replica`.
Must not import: `vehicle` or any room above it.
"""
