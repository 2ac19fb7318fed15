"""Base of the car target: definitions that all its other packages use.

Owns: the kinematic bicycle model, the car's settings.
Offers: `bicycle`, `settings.CarSettings`.
Must not import: any other package of `car`.
"""
