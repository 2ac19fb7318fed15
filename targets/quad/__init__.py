"""Target `quad`: multicopters with an ArduPilot or PX4 autopilot.

Owns: the interface to the autopilot, the phases of a flight, motion control, the platform.
Offers: `platform.platform.Quad`, `platform.simple`, `platform.inside`, which the manifest names.
Must not import: the compiler, `sim`, `car`.
"""
