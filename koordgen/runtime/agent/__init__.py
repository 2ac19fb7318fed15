"""Agent: the process that controls one robot.

Owns: phases of the process (starting, joining, running, resting, rested), the joining protocol, rounds, output commit
    and persistence. `resting` means that the robot is stopping safely; `rested`, that it has stopped.
Offers: `process.main`, which a bundle's `__main__` calls, and `Agent` to simulators.
Must not import: targets. It may import all rooms of the runtime."""
