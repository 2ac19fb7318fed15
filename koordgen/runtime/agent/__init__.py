"""Agent: one robot's process.

Owns: phases from start to safe stop, joining, rounds, output commit, persistence.
Offers: `process.main`, which a bundle's `__main__` calls, and `Agent` to simulators.
Must not import: targets. It may import all packages of the runtime."""
