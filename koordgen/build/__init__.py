"""Build: from a checked program and a fleet to bundles.

Owns: the order of the passes (`pipeline`), the text of generated programs (`emit`), the plan of bundles (`bundle`).
Offers: `pipeline.check_file` and `pipeline.plan_file`.
Must not import: `verify` or any package above it.
"""
