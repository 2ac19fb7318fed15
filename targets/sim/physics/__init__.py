"""Physics: bodies that move in arrays, and their contacts.

Owns: the world, broad phase, contact engines, ray casting, wind, copters, cars and tyres.
Offers: `world.SimulatedWorld`, `engines.make`.
Must not import: sensing, autopilots, or any package above them.
"""
