"""Target `quad`: multicopters with an ArduPilot or PX4 autopilot.

Owns: the interface to the autopilot, the phases of a flight, motion control, the platform.
Offers: `platform.platform.Quad`, `platform.simple` and `platform.inside`. manifest.toml and the simulator name them.
Must not import: the compiler, `sim`, `car`.
"""
