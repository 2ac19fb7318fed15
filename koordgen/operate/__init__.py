"""Operation: a fleet at work, from one computer.

Owns: hosts over SSH, releases that all hosts take or none, start and stop, logs, status, dashboard data, emergency
    stop, motion capture.
Offers: `deploy`, `services`, `status`, `collect`, `estop`, `basestation`.
Must not import: `cli`, `experiment`. `host_tool` runs on robots and needs nothing but Python.
"""
