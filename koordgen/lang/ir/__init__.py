"""IR: programs with types, as checks leave them and all back ends read them.

Owns: nodes, the ways through their trees, the table of built-in functions, the printer, the verifier, the canonical
encoding that is hashed.
Offers: `decl.Program`, `tree`, `verify`, `encoding`.
Must not import: syntax, checks, semantics.
"""
