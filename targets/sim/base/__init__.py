"""Base of the simulator.

Owns: the scenario, interfaces of bodies and devices, the schedule of faults, the communication medium, the run folder.
Offers: `Scenario`, `BodyState`, `Device`, `Medium`.
Must not import: any other package of `sim`.
"""
