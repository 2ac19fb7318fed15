"""Drives: interfaces to the devices that move the car.

Owns: VESC and rover protocols, links, the watchdog process that brakes if the agent stops sending commands.
Offers: `drive.Drive`, `links.Links`.
Must not import: `platform`.
"""
