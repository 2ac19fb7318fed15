"""MAVLink: the way to an autopilot.

Owns: bytes over UDP, TCP or serial, frames, one vehicle with its heartbeats and commands, its parameters.
Offers: `link.Link`, `parameters`.
Must not import: any target.
"""
