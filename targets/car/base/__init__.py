"""Base of the car.

Owns: the kinematic bicycle model, the car's settings.
Offers: `bicycle`, `settings.CarSettings`.
Must not import: any other package of `car`.
"""
