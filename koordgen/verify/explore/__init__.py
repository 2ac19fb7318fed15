"""Explore: everything that a fleet can come to, by generated code over packed states.

Owns: environments, rounds, search, symmetry, the shortest run to what must not be.
Offers: `search`, `show`.
Must not import: audit, attack.
"""
