"""Report: verdicts of the prover, and reasons why a proof fails.

Owns: verdicts, the assumption ledger, counterexamples replayed by the semantics, strengthenings, tables, traces.
Offers: `verdict.prove`, `show`.
Must not import: explore, audit, attack.
"""
