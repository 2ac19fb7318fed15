"""IR: typed intermediate representation of programs, made by the checks and read by all back ends.

Owns: nodes, walks over their trees, the table of builtin functions, the printer, the verifier, the canonical encoding
    whose digest is a program's hash.
Offers: `decl.Program`, `tree`, `verify`, `encoding`.
Must not import: syntax, checks, semantics.
"""
