"""Checks of expressions.

Owns: names, calls, collections, operators, spellings of the 2020 dialect.
Offers: `expr.check_expr`, and checkers of calls, names and collections, to `statements`.
Must not import: `statements`, `sections`.
"""
