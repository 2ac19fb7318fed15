"""Experiments: many simulated runs of a program, and statistics about them.

Owns: campaigns, and the validation of a program's assumptions by sampled runs.
Offers: the packages `campaign` and `validate`.
Must not import: `operate`, `cli`.
"""
