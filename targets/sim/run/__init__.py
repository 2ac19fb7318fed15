"""Run: from launch to rest, the same on both clocks.

Owns: the run, the interface of agents and clocks (`crew`), the stage of bodies and devices, faults as they happen.
Offers: `run.Run`, `crew.Conduct`.
Must not import: `realtime`, `lockstep`, `judging`, `view`.
"""
