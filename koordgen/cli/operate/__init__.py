"""Commands that operate a fleet: deploy, start, stop, logs, collect, status, dashboard.

Owns: options of connections, output and exit status of these commands. The work itself is done by `koordgen.operate`.
Offers: a function for each command.
Must not import: `cli.verify`, `cli.experiment`.
"""
