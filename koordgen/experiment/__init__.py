"""Experiments: many runs, and what they say.

Owns: campaigns, and the validation of a program's assumptions by sampled runs.
Offers: one room for each.
Must not import: `operate`, `cli`.
"""
