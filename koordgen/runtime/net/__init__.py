"""Network of a fleet: from sockets to authenticated messages and back.

Owns: wire format, fragments, patches, authentication, replay protection, transports, fleet clock, figures of links.
Offers: `Link`, the transports, the C receive path (`gate`, `courier`, `ledger`) with its C sources.
Must not import: `replication` or any room above it.
"""
