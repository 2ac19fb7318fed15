"""Checks of a robot before a mission (`--doctor`, `--check`), from its files to its vehicle, without motion."""

from __future__ import annotations

import ipaddress
import shutil
import socket
import threading
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from koordgen.runtime.config.settings import BadSettings, Peer, Settings, load
from koordgen.runtime.native import protocol
from koordgen.runtime.net import inbox
from koordgen.runtime.net.layout import Layout, TooLarge
from koordgen.runtime.net.seal import BadKey
from koordgen.runtime.net.transport import CannotOpen
from koordgen.runtime.ops.control import Control
from koordgen.runtime.ops.host import Clocks, disk, host
from koordgen.runtime.ops.set_up import fleet_program, open_key, open_settings, open_transport, programs_of
from koordgen.runtime.program.extern import BadExtern
from koordgen.runtime.program.fleet_program import FleetProgram
from koordgen.runtime.program.program import Program
from koordgen.runtime.trace.parts import MEGABYTE, size_of
from koordgen.runtime.vehicle.drivers import Drivers, with_drivers
from koordgen.runtime.vehicle.platform import Finding, Platform, Unready

MANY_MESSAGES = 1000  # from this number of messages a second on, the modules of the shared memory should be compiled
LOOKUP = 3.0  # seconds within which the addresses of all hosts must be found

PlatformType = Callable[[Settings, bytes | None], Platform]


class OuterRobot(NamedTuple):
    """Robot of the outer fleet that this robot's fleet is. `settings`, `overrides`: its files; see `load`."""

    program: Program
    settings: Path
    overrides: Path | None


def examine(
    program: Program | FleetProgram, root: Path, overrides: Path | None, pid: int | None,
    platform_type: PlatformType, drivers: Drivers, outer: OuterRobot | None = None,
) -> Generator[Finding, None, None]:  # fmt: skip
    """Run all checks of a robot, and yield each result immediately.

    outer: the outer robot, if this robot's fleet is a robot of another fleet.
    Checks that depend on a failed check are left out. Close the generator to end the checks early and to free the
    resources that they use."""
    clocks = Clocks()
    yield from host(root)
    try:
        settings = open_settings(root, overrides, pid)
        fleet = fleet_program(program, settings)
    except BadSettings as error:
        yield Finding("settings", "fail", str(error))
        return
    yield Finding(
        "settings",
        "ok",
        f"robot {settings.robot}, pid {settings.pid} of {len(settings.peers)}, delta {settings.delta} s",
    )
    yield _program(fleet, settings)
    yield _compiled()
    yield _protocol(settings, root)
    if settings.state is not None:
        yield disk(root.resolve().parent / settings.state)
    if settings.trace is not None:
        yield _trace(Path(settings.trace).resolve(), settings.trace_limit)
    key, found = _key(settings)
    yield found
    yield from _network(settings, key)
    if outer is not None:
        yield from _outer(outer, settings)
    yield from _body(settings, key, fleet.of(settings.pid), platform_type, drivers)
    yield clocks.finding()


def _outer(outer: OuterRobot, inner: Settings) -> Iterator[Finding]:
    """Check the outer robot on this robot, which may become its host: program, settings, key, and addresses."""
    try:
        if outer.program.library is not None:
            outer.program.library.load()
        settings = load(outer.settings, outer.overrides)
    except (BadExtern, BadSettings) as error:
        yield Finding("outer", "fail", str(error))
        return
    if settings.application_id == inner.application_id:
        why = "robots tell the two fleets apart by it: give the inner fleet file another `application_id`"
        found = f"application_id {settings.application_id}, as in the inner fleet"
        yield Finding("outer", "fail", found, "two different ones", why)
        return
    detail = f"{outer.program.name} {outer.program.program_hash}"
    yield Finding("outer", "ok", f"robot {settings.robot} of {detail}, delta {settings.delta} s")
    yield replace(_key(settings)[1], name="outer key")
    yield from [replace(each, name=f"outer {each.name}") for each in _peers(settings)]


def _trace(path: Path, limit: float | None) -> Finding:
    """Check that the disk has room for the whole trace: it must not become full before the trace reaches its limit."""
    try:
        free, used = shutil.disk_usage(path.parent).free / MEGABYTE, size_of(path) / MEGABYTE
    except OSError as error:
        return Finding("trace", "fail", f"{path.parent}: {error.strerror}", why="the robot writes its trace to it")
    detail = f"{free:.0f} MB free in {path.parent}"
    if limit is None:
        return Finding("trace", "warn", f"{detail}, no limit", why="the trace will fill the disk: set `trace_limit`")
    detail += f", the trace takes {used:.0f} of at most {limit:.0f} MB"
    if free < limit - used:
        why = "the disk will be full before the trace reaches its limit: free disk space, or set a lower `trace_limit`"
        return Finding("trace", "warn", detail, f"{limit - used:.0f} MB free", why)
    return Finding("trace", "ok", detail)


def _program(program: FleetProgram, settings: Settings) -> Finding:
    try:
        Layout.of(program)
        for own in programs_of(program, settings.pid):
            if own.library is not None:
                own.library.load()
    except (TooLarge, BadExtern) as error:
        return Finding("program", "fail", str(error))
    release = f", release {settings.release}" if settings.release else ""
    detail = f"{program.name} {program.program_hash}, interface {program.interface_hash}{release}"
    return Finding("program", "ok", detail + _applications(program, settings.pid))


def _applications(fleet: FleetProgram, robot: int) -> str:
    """Name each application of a fleet that has several, and this robot's place in it; "" for only one."""
    found = []
    for application in fleet.applications if fleet.is_composed else ():
        members = application.members
        place = f"pid {members.index(robot)} of {len(members)}" if robot in members else "not on this robot"
        found.append(f"; {application.name} {application.program.program_hash}: {place}")
    return "".join(found)


def _compiled() -> Finding:
    """Compile the C code of the socket I/O and cache it, so that the first mission does not wait for the compiler."""
    began = time.perf_counter()
    reason = inbox.accelerator()
    took = 1e3 * (time.perf_counter() - began)
    if reason:
        why = f"{inbox.PYTHON_COSTS}: install a C compiler (`apt install gcc`)"
        return Finding("compiled", "warn", reason, "socket I/O in C", why)
    return Finding("compiled", "ok", f"socket I/O in C, loaded in {took:.0f} ms")


def _protocol(settings: Settings, root: Path) -> Finding:
    """Check that the modules of the shared memory run compiled, unless the fleet sends few messages."""
    messages = (len(settings.peers) - 1) / settings.delta
    if protocol.is_used():
        return Finding("protocol", "ok", "the shared memory's modules run compiled")
    found = f"the shared memory's modules run interpreted, with {messages:.0f} messages a second"
    if messages < MANY_MESSAGES:
        return Finding("protocol", "ok", found)
    why = f"a round would take a quarter less of the processor: run `python3 {root} --compile`, once"
    return Finding("protocol", "warn", found, "compiled modules", why)


def _key(settings: Settings) -> tuple[bytes | None, Finding]:
    """Load and check the fleet's key. Return None in place of a bad key, so that further checks can run without it.

    Without the key, feeds are not authentic."""
    try:
        key = open_key(settings)
    except (BadKey, BadSettings) as error:
        return None, Finding("key", "fail", str(error))
    if key is None:
        why = "every computer on this network can control this robot: create a key with `koordgen key new`"
        return None, Finding("key", "warn", "INSECURE: there is none", "a key", why)
    return key, Finding("key", "ok", f"{settings.key_file}, {len(key)} bytes, readable by its owner alone")


def _network(settings: Settings, key: bytes | None) -> Iterator[Finding]:
    """Check the addresses of all robots, and that this robot's ports are free."""
    yield from _peers(settings)
    own = settings.peers[settings.pid]
    detail = f"{settings.bind or own.host}:{settings.control_port} is free: emergency stop and --status"
    yield _opens("control", detail, lambda: Control.open(settings, key).close())


def _peers(settings: Settings) -> Iterator[Finding]:
    """Check the addresses of all robots of a fleet, and that this robot's own one is free."""
    missing = unknown(settings.peers, LOOKUP)
    if missing:
        hint = "check the name server, or write IP addresses into the fleet file, or host names into /etc/hosts"
        yield Finding("peers", "fail", f"no address for {', '.join(missing)}", why=hint)
    elif all(is_loopback(peer.host) for peer in settings.peers):
        hosts = ", ".join(sorted({peer.host for peer in settings.peers}))
        why = "agents on several computers cannot hear one another, and no other computer can stop them: write each "
        why += "robot's own address into the fleet file, and build again. All agents on one host need no change"
        yield Finding(
            "peers", "warn", f"all {len(settings.peers)} robots are at {hosts}", "addresses in a network", why
        )
    else:
        yield Finding("peers", "ok", f"all {len(settings.peers)} have addresses")
    own, network = settings.peers[settings.pid], settings.network
    place = settings.bind or own.host
    if not missing:  # a missing address would make this check fail with an error that is already reported
        detail = f"{place}:{own.port} is free, {network.transport} {network.group}".rstrip()
        if network.transport == "zenoh":
            detail = f"zenoh opens as {network.mode}"
        yield _opens("port", detail, lambda: open_transport(settings).close())


def _opens(name: str, detail: str, open_and_close: Callable[[], None]) -> Finding:
    try:
        open_and_close()
    except CannotOpen as error:
        return Finding(name, "fail", str(error))
    return Finding(name, "ok", detail)


def is_loopback(host: str) -> bool:
    """Return whether a host name or IP address is a loopback address, which no other computer can reach."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host.lower().rstrip(".") in ("localhost", "ip6-localhost", "ip6-loopback")


def unknown(peers: Sequence[Peer], seconds: float) -> list[str]:
    """Return the hosts whose address is not found within `seconds`. All hosts are looked up in parallel."""
    waiting = {peer.host for peer in peers}

    def look_up(host: str) -> None:
        try:
            socket.getaddrinfo(host, None, type=socket.SOCK_DGRAM)
        except (OSError, UnicodeError):
            return
        waiting.discard(host)

    threads = [threading.Thread(target=look_up, args=(host,), daemon=True) for host in sorted(waiting)]
    for thread in threads:
        thread.start()
    end = time.monotonic() + seconds
    for thread in threads:
        thread.join(max(0.0, end - time.monotonic()))
    return sorted(waiting)


def _body(
    settings: Settings, key: bytes | None, program: Program, platform_type: PlatformType, drivers: Drivers
) -> Iterator[Finding]:
    try:
        platform = platform_type(settings, key)
    except BadSettings as error:
        yield Finding("body", "fail", str(error))
        return
    except Unready as error:
        yield Finding.of("body", error)
        return
    try:
        platform = with_drivers(platform, program, drivers)
    except Unready as error:
        yield Finding.of("drivers", error)
        return
    try:
        yield from platform.diagnose()
    finally:
        platform.close()
