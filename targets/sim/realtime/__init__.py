"""Real time: agents as processes, a network with faults, steps that are due by the clock.

Owns: processes, the relay, the pace.
Offers: `realtime.RealTime`, a `crew.AgentsAndClock`.
Must not import: `lockstep`, `view`.
"""
