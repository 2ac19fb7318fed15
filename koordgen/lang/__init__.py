"""The language Koord: parser, checks, typed IR, semantics, formatter.

Owns: sources and spans, diagnostics, syntax, IR, checks, analysis, semantics, format.
Offers: `syntax.parse.parse`, `analyze.program.check`, the IR, `semantics.step`.
Must not import: any other package except the values and property classes of the runtime.
"""
