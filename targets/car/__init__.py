"""Target `car`: car-like robots driven by a VESC motor controller or by an ArduPilot rover.

Owns: path planning, control, drives, the platform.
Offers: `platform.platform.Car`, `platform.simple`, `platform.inside`, which the manifest names.
Must not import: the compiler, `sim`, `quad`.
"""
