"""Commands that verify: prove, explore, audit, replay.

Owns: what is asked, what is printed, and the exit status of each.
Offers: one module for each command.
Must not import: other commands' rooms.
"""
