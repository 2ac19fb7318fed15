"""First check of a program: resolves names and types, and translates the syntax tree to IR.

The IR still has draft nodes (`ir.draft`): statements that only the second check needs, and that it removes.

Owns: names, types, rules of what each section may read and write. No check in this package depends on control flow.
Offers: `sections.program.resolve` to `analyze`.
Must not import: `analyze`, `format`, or any package outside of `lang`.
"""
