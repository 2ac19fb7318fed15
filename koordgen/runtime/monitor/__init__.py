"""Monitors: evaluate the program's properties on a robot during the mission.

Owns: one robot's verdicts on properties, the text that explains a violation, the CPU budget of the evaluation.
Offers: `Monitor`.
Must not import: `ops` or `agent`.
"""
