"""Bundles: the files of each robot.

Owns: whether targets offer the ports, whether a round fits, the plan (pure) and its writing.
Offers: `plan` and `write.write`, which alone touches the output.
Must not import: the checker.
"""
