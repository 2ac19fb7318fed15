"""Checks of expressions.

Owns: names, calls, collections, operators, numbers, words of the 2020 dialect.
Offers: `expr.Expressions` and its parts to statements.
Must not import: `statements`, `sections`.
"""
