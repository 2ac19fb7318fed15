"""Platform: the multicopter behind the ports of a program.

Owns: ports, the quad without an autopilot, the quad in a simulator.
Offers: the entries that the manifest names.
Must not import: `sim`.
"""
