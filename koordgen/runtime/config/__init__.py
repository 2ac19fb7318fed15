"""Settings of one robot.

Owns: `settings.json`, typed and checked.
Offers: `Settings` and the readers of its parts.
Must not import: any package but `values`.
"""
