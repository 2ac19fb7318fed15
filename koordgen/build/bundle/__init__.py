"""Bundles: the files of each robot.

Owns: checks of ports, of sizes and of the user's Python files; the plan (pure) and its writing.
Offers: `plan.plan`, and `write.write`, the only function that touches the output folder.
Must not import: the checker.
"""
