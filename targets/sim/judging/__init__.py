"""Judging: decides which properties held in a run.

Owns: properties over the true state, distances to the limits of assumptions, idle runs, host load, the summary.
Offers: observers that accompany a run, and `summary`.
Must not import: `view`.
"""
