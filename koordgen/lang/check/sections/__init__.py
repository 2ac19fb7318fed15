"""Checks of a program's sections.

Owns: declarations, events, functions, modules, params; the order in which sections are checked.
Offers: `program.resolve`, the only entry point.
Must not import: any package outside of `lang`.
"""
