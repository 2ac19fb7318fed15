"""Experiments: many simulation runs of a program, and the statistics of their results.

Owns: campaigns, and the validation of a program's assumptions by simulation runs.
Offers: the packages `campaign` and `validate`.
Must not import: `operate`, `cli`.
"""
