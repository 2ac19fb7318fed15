"""MAVLink connection to an autopilot.

Owns: transports (UDP, TCP, serial), framing, the link to one vehicle with heartbeats and commands, its parameters.
Offers: `link.Link`, `parameters`.
Must not import: any target.
"""
