"""Follow: a counterexample as rounds that agents can be made to run. Pure.

Owns: the plan of such a run.
Offers: `plan`, `read`.
Must not import: explore, audit; it writes no file and starts no process.
"""
