"""Validation: checks a program's assumptions about its ports in simulation runs, for each kind of robot.

A platform is a kind of robot together with the fidelity of its simulation, such as `quad full`.

Owns: samples of runs, verdicts with statistical bounds, suggested assumptions, reachsets.
Offers: `samples`, `table`, `reach`.
Must not import: `operate`, `cli`.
"""
