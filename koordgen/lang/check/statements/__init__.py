"""Checks of statements.

Owns: assignments, updating methods, loops, control flow.
Offers: `stmt.check_block` to `sections`.
Must not import: `sections`.
"""
