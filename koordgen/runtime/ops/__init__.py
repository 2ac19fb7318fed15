"""Operation of one robot: requests of operators and tools to an agent.

Owns: emergency stop, status reports, checks before a mission, log lines, messages to the service manager.
Offers: `Control`, `Journal`, `doctor`; `orders` and `status` to the operating computer.
Must not import: `agent`."""
