"""Vehicle: the program's ports over a platform.

Owns: the platform interface, ports, geofence and stale positions, drivers of users, feeds, lidar scans.
Offers: `Platform` to targets, `VehicleInterface` to the agent.
Must not import: `trace` or any package above it."""
