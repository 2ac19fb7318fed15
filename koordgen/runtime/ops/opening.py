"""Set-up of an agent from its bundle: settings, key, transport."""

from __future__ import annotations

from pathlib import Path

from koordgen.runtime.config.settings import BadSettings, Settings, load
from koordgen.runtime.net.seal import load_key
from koordgen.runtime.net.transport import CannotOpen, Transport
from koordgen.runtime.net.udp import GroupTransport, UnicastTransport


def open_settings(root: Path, overrides: Path | None, pid: int | None) -> Settings:
    """Return the settings of the bundle in `root`. Raises BadSettings.

    overrides: settings file whose values replace those of the bundle; it suffices alone if the bundle has none.
    pid: replaces the pid of the bundle's settings.
    """
    path = root / "settings.json"
    if path.exists():
        return load(path, overrides, pid)
    if overrides is not None:
        return load(overrides, None, pid)
    raise BadSettings(
        f"{path}: not found, because this bundle was built without a fleet file; build it with "
        "`koordgen build ... --fleet FILE`, or give `--settings FILE`"
    )


def open_key(settings: Settings) -> bytes | None:
    """Return the fleet's key, None if the settings declare that there is none.

    Raises BadKey, and BadSettings if the settings declare neither."""
    if settings.key_file is not None:
        return load_key(Path(settings.key_file))
    if not settings.insecure:
        raise BadSettings("no key_file; a fleet without a key must declare `insecure: true`")
    return None


def open_transport(settings: Settings) -> Transport:
    """Return the transport of the settings.

    Imports the optional package only if needed. Raises CannotOpen."""
    network = settings.network
    if network.transport == "unicast":
        return UnicastTransport(settings.peers, settings.pid, settings.bind)
    if network.transport != "zenoh":
        return GroupTransport(settings.peers, settings.pid, settings.bind, network)
    try:
        from koordgen.runtime.net.zenoh_transport import ZenohTransport
    except ImportError as error:
        from koordgen.runtime.ops.host import pip_install

        install = pip_install("'eclipse-zenoh>=1.10'")
        raise CannotOpen(
            f"robot {settings.robot}: transport zenoh needs a package that does not load ({error}): {install}"
        ) from None
    return ZenohTransport(settings)
