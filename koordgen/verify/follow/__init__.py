"""Execution of a counterexample by agents: plans the rounds in which agents can execute it.

`koordgen sim --follow` uses the plan.

Owns: the plan of a run that executes a counterexample.
Offers: `plan`, `read`.
Must not import: explore, audit; it writes no file and starts no process.
"""
