"""Fleet: the fleet file, and the files that it names.

Owns: YAML with line numbers, manifests of targets, robots, world, obstacles, meshes, starts, network, motion capture,
    deployment, scenarios.
Offers: `file.read`, which returns a checked `Fleet`; `manifest.load`.
Must not import: `build` or any package above it.
"""
