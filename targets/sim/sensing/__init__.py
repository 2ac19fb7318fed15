"""Sensing: what simulated robots measure.

Owns: lidar scans, poses from outside, a GPS of its own.
Offers: devices.
Must not import: autopilots, or any package above them.
"""
