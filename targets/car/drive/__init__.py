"""Drive: the device that moves the car.

Owns: VESC and rover protocols, links, the watchdog process that brakes when the agent falls silent.
Offers: `drive.Drive`, `links.Links`.
Must not import: `platform`.
"""
