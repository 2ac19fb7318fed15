"""Encoding of the IR as SMT terms.

Owns: expressions, statements, loops, functions, collections and geometry as terms. A comment with SOUND marks each
approximation and says why proofs stay sound.
Offers: `expr.Encoder`, `stmt.SymbolicFrame`.
Must not import: `obligations`, `report`.
"""
