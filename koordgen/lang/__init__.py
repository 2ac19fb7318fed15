"""The language Koord: from the text of a program to its typed, checked IR, and what it means.

Owns: sources and places in them, diagnostics, syntax, IR, analysis, checks, semantics, format.
Offers: `syntax.parse.parse`, `check.sections.program.check`, the IR, `semantics.step`.
Must not import: any other room but the values and property classes of the runtime.
"""
