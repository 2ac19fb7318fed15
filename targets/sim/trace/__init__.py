"""Trace of a run: its records, and what they say.

Owns: the schema, merging of robots' traces, the true state round by round, beliefs.
Offers: `schema`, `collected`, `truth`, `beliefs`.
Must not import: runs, judging, view.
"""
