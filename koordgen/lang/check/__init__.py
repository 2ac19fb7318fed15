"""Checks: syntax tree to IR.

Owns: names, types, ownership, bounds; the context of a check. `expressions`, `statements` and `sections` build on it.
Offers: `sections.program.check`, `sections.params`.
Must not import: format, or any room outside of `lang`.
"""
