"""Audit: traces of a whole fleet, judged after every round by the generated properties.

Owns: reading of several traces, clocks, verdicts, which assumption of a proof broke, pictures.
Offers: `judge`, `finding`, `story`.
Must not import: explore, attack.
"""
