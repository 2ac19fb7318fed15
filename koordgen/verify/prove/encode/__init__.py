"""Encoding: IR to terms.

Owns: expressions, statements, loops, functions, collections and geometry as terms; each approximation is marked.
Offers: `expr.Encoder`, `stmt.Frame`.
Must not import: `obligations`, `report`.
"""
