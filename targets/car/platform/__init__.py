"""Platform: the car behind the ports of a program.

Owns: ports, diagnosis before a mission, the car in a simulator.
Offers: the entries that the manifest names.
Must not import: `sim`.
"""
