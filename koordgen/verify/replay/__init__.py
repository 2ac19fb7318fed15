"""Replay: runs a traced program again by the executable semantics, on the inputs that robots recorded.

Owns: reading of traces, and checks of the records in traces.
Offers: `trace.open_trace`, `robot`, `fleet`.
Must not import: the prover, explore, audit.
"""
