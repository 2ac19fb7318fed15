"""Rules: one file each. A rule is asked at a point, and reports its own codes, which its first line names.

Owns: the diagnostics of the analysis; the page NAME.md beside NAME.py explains the codes of a rule.
Offers: its rules to the walk; `analysis`, the state of the walk; `evidence`, what indices and divisors share.
Must not import: the walk.
"""
