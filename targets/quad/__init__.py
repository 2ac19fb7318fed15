"""Target `quad`: multicopters with an ArduPilot or PX4 autopilot.

Owns: the autopilot's link and life of a flight, motion, the platform.
Offers: `platform.platform.Quad`, `platform.simple`, `platform.inside`, which the manifest names.
Must not import: the compiler, `sim`, `car`.
"""
