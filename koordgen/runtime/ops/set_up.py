"""Set-up of an agent from its bundle: settings, key, transport, programs, trace."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from koordgen.runtime.config.settings import BadSettings, Settings, load
from koordgen.runtime.net.seal import load_key
from koordgen.runtime.net.transport import CannotOpen, Transport
from koordgen.runtime.net.udp import GroupTransport, UnicastTransport
from koordgen.runtime.program.fleet_program import FleetProgram
from koordgen.runtime.program.program import Program
from koordgen.runtime.trace.parts import MEGABYTE, TraceFileParts, set_aside
from koordgen.runtime.trace.writer import Trace


def open_settings(root: Path, overrides: Path | None, pid: int | None) -> Settings:
    """Return the settings of the bundle in `root`. Raises BadSettings.

    overrides: settings file whose values replace the bundle's values. A bundle without settings needs only this file.
    pid: pid that replaces the pid in the settings; None keeps it.
    """
    path = root / "settings.json"
    if path.exists():
        return load(path, overrides, pid)
    if overrides is not None:
        return load(overrides, None, pid)
    raise BadSettings(
        f"{path}: not found, because this bundle was built without a fleet file; build the bundle with "
        "`koordgen build ... --fleet FILE`, or give `--settings FILE`"
    )


def open_key(settings: Settings) -> bytes | None:
    """Return the fleet's key, or None if the settings declare `insecure: true`.

    Raises BadKey if the key is bad. Raises BadSettings if the settings declare neither a key file nor `insecure`."""
    if settings.key_file is not None:
        return load_key(Path(settings.key_file))
    if not settings.insecure:
        raise BadSettings("no key_file; a fleet without a key must declare `insecure: true`")
    return None


def fleet_program(program: Program | FleetProgram, settings: Settings) -> FleetProgram:
    """Return the applications of a bundle's fleet.

    Raises BadSettings if the settings are of another fleet, or a program is of another build than the others."""
    robots = len(settings.peers)
    if isinstance(program, Program):
        return FleetProgram.alone(program, robots)
    if program.robots != robots:
        raise BadSettings(f"the settings have {robots} robots, but the bundle was built for {program.robots}")
    for application in program.applications:
        found, wanted = application.program.program_hash, application.program_hash
        if wanted and found != wanted:
            raise BadSettings(
                f"the bundle has files of two builds: the program of {application.name} has the hash {found}, but "
                f"applications.py was built with {wanted}; build the bundle again, and copy all of it"
            )
    return program


def programs_of(fleet: FleetProgram, robot: int) -> tuple[Program, ...]:
    """Return the program of each instance of a robot."""
    return tuple([fleet.applications[instance.application].program for instance in fleet.of_robot(robot)])


def open_transport(settings: Settings) -> Transport:
    """Open the transport that the settings name. Raises CannotOpen.

    The optional package eclipse-zenoh is imported only for the transport `zenoh`."""
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


def open_trace(settings: Settings, warn: Callable[[str], None]) -> Trace:
    """Open the trace that the settings name; an earlier trace is set aside. Raises CannotOpen."""
    if settings.trace is None:
        return Trace(None, warn)
    path, limit = Path(settings.trace).resolve(), settings.trace_limit
    try:
        if limit is not None and (path.is_file() or not path.exists()):  # only regular files are split into parts
            return Trace(TraceFileParts(path, settings.robot, round(limit * MEGABYTE)), warn)
        set_aside(path)
        return Trace(path.open("wb"), warn)
    except OSError as error:
        raise CannotOpen(f"trace: {settings.trace}: {error.strerror or error}") from None
