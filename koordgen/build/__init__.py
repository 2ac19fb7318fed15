"""Build: from a checked program and a fleet to bundles.

Owns: the passes in order (`pipeline`), the text of generated programs (`emit`), the plan of bundles (`bundle`).
Offers: `pipeline.check_file` and `pipeline.plan_file`.
Must not import: `verify` or any room above it.
"""
