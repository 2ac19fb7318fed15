"""Autopilot: what is sent to it, and what it says.

Owns: firmware facts, telemetry, checks, positions from outside, the life of a flight.
Offers: `flight.Flight`, `positioning`, `diagnosis`.
Must not import: `motion`, `platform`.
"""
