"""Robot-side tool of deployments: stores a fleet's releases in one folder of a host, and runs agents.

The operator's computer packs this package into one file (`koordgen.operate.host_tool_archive`) and exchanges requests
and answers with it over SSH. The tool runs with the host's own Python (3.10 or later), so it imports nothing but the
standard library and itself. The file `deployment.json` alone decides which release may run.

Owns: releases on disk, agents as services or processes, logs, one session over standard input and output.
Offers: `__main__`, which the operating computer starts over SSH.
Must not import: anything but Python's library.
"""

TOOL = 1  # version of the protocol between the operator's computer and this tool
