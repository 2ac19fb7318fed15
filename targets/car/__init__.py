"""Target `car`: cars with a VESC or an ArduPilot rover.

Owns: planning, control, drives, the platform.
Offers: `platform.platform.Car`, `platform.simple`, `platform.inside`, which the manifest names.
Must not import: the compiler, `sim`, `quad`.
"""
