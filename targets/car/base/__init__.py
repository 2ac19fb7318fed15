"""Base of the car target: what all of its other rooms use.

Owns: the kinematic bicycle model, the car's settings.
Offers: `bicycle`, `settings.CarSettings`.
Must not import: any other package of `car`.
"""
