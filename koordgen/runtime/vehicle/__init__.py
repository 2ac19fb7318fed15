"""Vehicle: connects the ports of a program with the platform of a robot.

Owns: the platform interface, ports, the checks of geofence and position, users' drivers, position feeds, lidar scans.
Offers: `Platform` to targets, `VehicleInterface` to the agent.
Must not import: `trace` or any package above it."""
