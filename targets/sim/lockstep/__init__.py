"""Lockstep: agents in this process, on a clock that the run owns.

Owns: agents' own modules, wires in memory, what a robot finds again after a crash.
Offers: `run.Lockstep`, a `crew.AgentsAndClock`.
Must not import: `realtime`, `view`.
"""
