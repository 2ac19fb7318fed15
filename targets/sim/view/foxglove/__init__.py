"""Foxglove: a run as MCAP or as a stream.

Owns: schemas, messages, the scene, the recording, the live stream.
Offers: `recording`, `stream`.
Must not import: `web`, `pictures`.
"""
