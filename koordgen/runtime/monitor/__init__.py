"""Monitors: the program's properties, judged on a robot while it runs.

Owns: three-valued verdicts of one robot, their explanation in words, the processor time that they may take.
Offers: `Monitor`.
Must not import: `ops` or `agent`.
"""
