"""Validation: checks a program's port assumptions against simulated platforms.

Owns: samples, windows, verdicts with bounds, suggestions, reachsets.
Offers: `samples`, `table`, `reach`.
Must not import: `operate`, `cli`.
"""
