"""Trace of one robot.

Owns: records of rounds, their file and its parts, observations and verdicts of monitors.
Offers: the schema, `Trace`, which writes, and the names of a trace's files.
Must not import: `monitor` or any package above it."""
