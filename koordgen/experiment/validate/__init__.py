"""Validation: checks a program's assumptions about ports by simulated runs of platforms.

A platform is a robot's target together with the fidelity of its simulation.

Owns: samples, windows, verdicts with bounds, suggestions, reachsets.
Offers: `samples`, `table`, `reach`.
Must not import: `operate`, `cli`.
"""
