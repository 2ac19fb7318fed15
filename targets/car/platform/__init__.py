"""Platform of the car: connects a program's ports with the car.

Owns: ports, diagnosis before a mission, the car in a simulator.
Offers: the entries that the manifest names.
Must not import: `sim`.
"""
