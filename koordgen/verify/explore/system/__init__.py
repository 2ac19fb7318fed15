"""Exploration of a system of several applications (ADR 0055), by the searches of single programs.

Owns: packed states of a system, rounds of instances, guarantees, environment of robots with several applications.
Offers: `search`, `show`.
Must not import: audit, attack.
"""
