"""Explorer: explicit-state search of all runs of a small fleet.

The explorer runs the same generated code that robots run.

Owns: environments, rounds, search, state-space reductions, the shortest run to a violation.
Offers: `search`, `show`.
Must not import: audit, attack.
"""
