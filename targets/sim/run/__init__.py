"""Run: from launch to rest, the same on both clocks.

Owns: the run, the interface of agents and clocks (`run_interface`), the scene of bodies and devices, injected faults.
Offers: `run.Run`, `crew.AgentsAndClock`.
Must not import: `realtime`, `lockstep`, `judging`, `view`.
"""
