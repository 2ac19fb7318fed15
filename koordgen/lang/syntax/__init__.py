"""Syntax: text to syntax tree.

Owns: the grammar `koord.lark`, layout, tokens, the LR driver, recovery from mistakes, advice on foreign habits.
Offers: `parse.parse`; the tree in `decl`, `stmt`, `expr` and `types`.
Must not import: IR or checks. lark is imported by `generate` alone.
"""
