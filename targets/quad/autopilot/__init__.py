"""Autopilot interface: commands sent to a quad's autopilot and telemetry received from it.

Owns: firmware facts, telemetry, pre-flight checks, external positioning, the phases of a flight.
Offers: `flight.Flight`, `positioning`, `diagnosis`.
Must not import: `motion`, `platform`.
"""
