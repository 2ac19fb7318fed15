"""Replay: a traced program again, by the semantics, on what its robots saw.

Owns: reading of traces and the checks of their records.
Offers: `trace.read`, `robot`, `fleet`.
Must not import: the prover, explore, audit.
"""
