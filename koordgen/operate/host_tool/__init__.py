"""Robot-side tool of deployments: keeps the releases of one fleet in one folder of one host, and runs their agents.

The deploying side packs this package into one file (`koordgen.operate.host_tool_archive`) and speaks with it over SSH.
The tool runs with the host's own Python (3.10 or later): it imports the standard library and itself, nothing else.
`deployment.json` alone decides which release may run; every other file can be made again from it.

Owns: releases on disk, agents as services or processes, logs, one session over standard input and output.
Offers: `__main__`, which the operating computer starts over SSH.
Must not import: anything but Python's library.
"""

TOOL = 1  # version of the session protocol
