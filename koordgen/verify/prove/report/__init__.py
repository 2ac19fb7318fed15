"""Report: verdicts of the prover, and the reasons why a proof fails.

Owns: verdicts, the list of assumptions, counterexamples that the executable semantics reproduces, suggestions for
stronger invariants, tables, traces.
Offers: `verdict.prove`, `show`.
Must not import: explore, audit, attack.
"""
