"""First check of a program: resolves names and types.

Makes IR with drafts (`ir.draft`) of the syntax tree.

Owns: names, types, rules of what each section may read and write. Nothing here depends on control flow.
Offers: `sections.program.resolve` to `analyze`.
Must not import: analyze, format, or any room outside of `lang`.
"""
