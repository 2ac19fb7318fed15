"""Traces of runs: their files, and the state that follows from their records.

Owns: files of traces, merging of robots' traces, the true state round by round, beliefs.
Offers: `files`, `collected`, `truth`, `beliefs`.
Must not import: runs, judging, view.
"""
