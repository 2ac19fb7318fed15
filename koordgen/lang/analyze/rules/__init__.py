"""Rules of the analysis, one file each. A rule reports the codes that its first line names.

Owns: the diagnostics of the analysis; the page NAME.md beside NAME.py explains the codes of a rule.
Offers: its rules to the walk, which applies them; `analysis`, the state of the walk; `evidence`, shared by rules
    about indices and divisors.
Must not import: the walk.
"""
