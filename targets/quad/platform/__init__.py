"""Platform of the quad: connects a program's ports with a multicopter.

Owns: the ports, the simulated quad without an autopilot, the quad with a simulated autopilot.
Offers: the classes and functions that manifest.toml names as entries.
Must not import: `sim`.
"""
