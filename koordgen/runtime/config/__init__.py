"""Settings of one robot: reader of the bundle's file `settings.json`.

Owns: the types of all settings, and the checks of their ranges.
Offers: `Settings`, the types of its parts, and `load`.
Must not import: any package except `values`.
"""
