"""Commands for verification: prove, explore, audit, replay.

Owns: the options, the output and the exit status of each command.
Offers: one module for each command.
Must not import: packages of other commands.
"""
