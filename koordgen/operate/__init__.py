"""Operation: deploy, start, watch and stop a fleet of robots from one computer.

Owns: SSH sessions with hosts, releases that are installed on all hosts or on none, start and stop of agents, logs,
    status, dashboard data, emergency stop, motion capture.
Offers: `deploy`, `services`, `status`, `collect`, `estop`, `basestation`.
Must not import: `cli`, `experiment`. `host_tool` runs on robots and needs nothing but Python.
"""
