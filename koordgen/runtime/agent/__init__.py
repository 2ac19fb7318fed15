"""Agent: the process that controls one robot.

Owns: phases of the process (starting, joining, running, stopping, stopped), the joining protocol, rounds, output commit
    and persistence. In phase `stopping` the robot is stopping safely; in phase `stopped` it has stopped.
Offers: `process.main`, which a bundle's `__main__` calls, and `Agent` to simulators.
Must not import: targets. It may import all packages of the runtime."""
