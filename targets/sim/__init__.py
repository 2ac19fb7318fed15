"""Target `sim`: the whole fleet on one computer, the robots' own bundles in a simulated world.

Owns: physics, simulated autopilots and sensors, faults, runs on two clocks, judgement, what is shown of a run.
Offers: `harness.main`, the bundle's entry.
Must not import: the compiler. Of other targets only the car's codecs, which the manifest names.
"""
