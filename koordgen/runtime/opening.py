"""Which kind of transport the settings ask for."""

from __future__ import annotations

from koordgen.runtime.settings import Settings
from koordgen.runtime.transport import CannotOpen, Transport
from koordgen.runtime.udp import GroupTransport, UnicastTransport

INSTALL_ZENOH = "pip install 'eclipse-zenoh>=1.10'"


def open_transport(settings: Settings) -> Transport:
    """The transport that the settings name; the optional package is imported only for its own. Raises CannotOpen."""
    network = settings.network
    if network.transport == "unicast":
        return UnicastTransport(settings.peers, settings.pid, settings.bind)
    if network.transport != "zenoh":
        return GroupTransport(settings.peers, settings.pid, settings.bind, network)
    try:
        from koordgen.runtime.zenoh_transport import ZenohTransport
    except ImportError as error:
        raise CannotOpen(
            f"robot {settings.robot}: transport zenoh needs a package that does not load ({error}): {INSTALL_ZENOH}"
        ) from None
    return ZenohTransport(settings)
