"""Agent: one robot's process.

Owns: phases from start to rest, joining, rounds, outputs, what a robot finds again after a crash.
Offers: `process.main`, which a bundle's `__main__` calls, and `Machine` to simulators.
Must not import: targets. It stands on all rooms of the runtime.
"""
