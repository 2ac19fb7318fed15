"""Commands that operate a fleet: deploy, start, stop, logs, collect, status, dashboard.

Owns: connections by options, what is asked, what is printed, and the exit status of each.
Offers: one module for each command.
Must not import: `cli.verify`, `cli.experiment`.
"""
