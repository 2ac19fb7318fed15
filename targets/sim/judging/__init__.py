"""Judging: what a run has shown.

Owns: properties over the true state, windows of assumptions, idle runs, host load, the summary.
Offers: companions of a run, and `summary`.
Must not import: `view`.
"""
