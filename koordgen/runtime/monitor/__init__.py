"""Monitors: evaluate the program's properties on a robot during the mission.

Owns: three-valued verdicts of one robot, their explanation in words, the processor time that they may take.
Offers: `Monitor`.
Must not import: `ops` or `agent`.
"""
