"""Fleet: the fleet file and all that it names.

Owns: YAML with places, manifests of targets, robots, world, obstacles, meshes, starts, medium, motion capture,
    deployment, scenarios.
Offers: `file.Fleet`, read and checked; `manifest.load`.
Must not import: `build` or any room above it.
"""
