"""Network of a fleet: from sockets to authenticated messages and back.

Owns: wire format, fragments, patches, authentication, replay protection, transports, fleet clock, link statistics.
Offers: `Link`, the transports, `inbox` for socket batch I/O (in Python, and in C where there is a compiler).
Must not import: `replication` or any room above it.
"""
