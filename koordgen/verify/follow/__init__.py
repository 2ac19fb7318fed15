"""Execution of a counterexample: plans rounds in which agents can run it (`koordgen sim --follow`).

Owns: the plan of such a run.
Offers: `plan`, `read`.
Must not import: explore, audit; it writes no file and starts no process.
"""
