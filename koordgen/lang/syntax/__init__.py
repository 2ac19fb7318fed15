"""Syntax: text to syntax tree.

Owns: the grammar `koord.lark`, layout, tokens, LR driver, error recovery, advice on syntax of other languages.
Offers: `parse.parse`; the tree in `decl`, `stmt`, `expr` and `types`.
Must not import: IR or checks. lark is imported by `generate` alone.
"""
