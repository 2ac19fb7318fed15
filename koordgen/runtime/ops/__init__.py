"""Operation of one robot: what people and tools ask of an agent.

Owns: emergency stop, status replies, the checks before a mission, log lines, notices to the service manager.
Offers: `Control`, `Journal`, `doctor`; `orders` and `status` to the operating computer.
Must not import: `agent`.
"""
