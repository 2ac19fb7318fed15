"""Checks of a program's sections.

Owns: declarations, events, functions, modules, params, the order in which sections are checked.
Offers: `program.check`: the only way in.
Must not import: any room outside of `lang`.
"""
