"""Encoding: the IR as terms of SMT.

Owns: expressions, statements, loops, functions, collections and geometry as terms. Each approximation is marked SOUND.
Offers: `expr.Encoder`, `stmt.SymbolicFrame`.
Must not import: `obligations`, `report`.
"""
