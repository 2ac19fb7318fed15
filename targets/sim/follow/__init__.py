"""Follow: a run in which agents are led through a counterexample.

Owns: the plan that is read, the guide of agents, bodies that are set.
Offers: `conduct`, `guide`, `plan`.
Must not import: `realtime`, `view`.
"""
