"""Semantics: an executable definition of the language, without side effects.

Owns: evaluation of expressions, statements, events and properties; exact numbers; limits.
Offers: `step`, `eval`, `property`. Back ends are tested against it.
Must not import: syntax, checks, or any back end.
"""
