"""Autopilots: devices in place of real ones.

Owns: simulated ArduPilot and PX4 copters, rovers, VESCs, and the link to a real ArduPilot.
Offers: devices, made by `run.scene`.
Must not import: runs, traces, or any package above them.
"""
