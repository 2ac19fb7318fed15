"""Second check: static analysis of the IR, which derives facts at each point and applies rules there.

Owns: `facts`, conditions known at a point; `rules`, one file each with its explanation beside it; the walk.
Offers: `program.check`, which runs both checks of a program; `params.with_params`.
Must not import: modules of `check` except `sections.program`; `format`; any package outside of `lang`.
"""
