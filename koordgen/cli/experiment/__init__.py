"""Commands for experiments: harnesses, campaign, validate, and commands for finished runs.

Owns: the options, the output and the exit status of each.
Offers: one module for each command.
Must not import: `cli.operate`.
"""
