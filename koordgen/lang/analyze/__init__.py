"""Second check: the analysis of the IR, which knows what holds at each point without running the program.

Owns: `facts`, what is decided at a point; `rules`, one file each, with its explanation beside it; the walk.
Offers: `program.check`, both checks of a program; `params.with_params`.
Must not import: any module of `check` but the way in; format, or any room outside of `lang`.
"""
