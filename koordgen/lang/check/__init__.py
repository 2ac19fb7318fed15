"""First check: names and types, syntax tree to IR with drafts (see `ir.draft`).

Owns: names, types, and what may be read and written where; nothing that depends on the way to a statement.
Offers: `sections.program.resolve` to `analyze`.
Must not import: analyze, format, or any room outside of `lang`.
"""
