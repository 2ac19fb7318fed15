"""Checks of statements.

Owns: assignments, updates, loops and whether their end can be seen.
Offers: the checker of a block.
Must not import: `sections`.
"""
