"""Trace of one robot.

Owns: records of rounds, the trace file and its parts, observations and verdicts of monitors.
Offers: the schema of a trace, `Trace`, which writes a trace, and the names of a trace's files.
Must not import: `monitor` or any package above it."""
