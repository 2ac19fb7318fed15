"""Experiments: many simulated runs of a program, and statistics about them.

Owns: campaigns, and the validation of a program's assumptions by sampled runs.
Offers: one package for each.
Must not import: `operate`, `cli`.
"""
