"""View: what people see of a run.

Owns: pages, pictures, films, tables and streams, all from the same rows of a trace.
Offers: `commands`, for `koordgen report`, `export` and `show`.
Must not import: physics, autopilots.
"""
