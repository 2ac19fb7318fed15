"""Runtime: the code that runs on robots, copied byte for byte into each bundle.

Owns: all code of an agent, except the compiled program and the platform (the code for one kind of vehicle).
Offers: `agent.process.main` to bundles, `vehicle.platform` to targets, `values` to the Python of users and to the
    compiler, which evaluates programs with the same values.
Must not import: the rest of koordgen, targets, any package but msgspec (and zenoh, in `net`, when settings name it).
"""
