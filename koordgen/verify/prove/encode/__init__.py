"""Encoding of the IR (the checked program) as SMT terms.

Owns: expressions, statements, loops, functions, collections and geometry as terms. A comment that begins with SOUND
marks an approximation and says why proofs stay sound.
Offers: `expr.Encoder`, `stmt.SymbolicFrame`.
Must not import: `obligations`, `report`.
"""
