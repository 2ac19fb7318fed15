"""Commands that run: harnesses, campaign, validate, and what is made of a run that is over.

Owns: what is asked, what is printed, and the exit status of each.
Offers: one module for each command.
Must not import: `cli.operate`.
"""
