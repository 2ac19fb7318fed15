"""`koordgen basestation`: sends each robot its own pose, as measured by a motion capture system.

The system is read through the package `motioncapture` (libmotioncapture), which is imported on use. Any module with the
same `connect`, `waitForNextFrame` and `rigidBodies` can replace it. The datagram format is in runtime/vehicle/feed.py.
"""

from __future__ import annotations

import queue
import socket
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from koordgen.fleet.address import parse_address
from koordgen.fleet.file import Fleet
from koordgen.fleet.manifest import Target, available, load
from koordgen.fleet.mocap import Mocap, Quaternion, Vector
from koordgen.lang.node import Node, replace
from koordgen.operate.physical import PhysicalRobot, physical_robots
from koordgen.runtime.net.seal import BadKey, load_key
from koordgen.runtime.ops.host import pip_install
from koordgen.runtime.vehicle.datagrams import raw_clock

RATE = 50.0  # default of the highest rate of datagrams to one robot, in Hz
SUMMARY_EVERY = 1.0  # seconds between two summary lines
SESSION = "basestation.session"  # file beside the fleet file that holds the session number of the last run
LOST = 1.0  # the summary shows a robot as not seen after this many seconds without a pose

# A frame is sent up to this fraction of a period early. Otherwise jitter would drop every second frame if the
# cameras' rate is near the rate of datagrams.
_JITTER = 0.25
_LOOK = 0.2  # longest wait for a frame in seconds; it is short, so the summary is printed even if no frame arrives

Body = tuple[Vector, Quaternion]
Frame = tuple[float, dict[str, Body]]  # a frame: its time of arrival in seconds, and the rigid bodies by name


class CannotServe(Exception):
    """Raised if the base station cannot send poses; `help` says what to do."""

    def __init__(self, message: str, help: str = "") -> None:
        super().__init__(message)
        self.help = help


class WrongFiles(CannotServe):
    """Raised if the fleet file or the key cannot be used."""


class Receiver(Node):
    """A robot, and the UDP address to which its poses are sent."""

    robot: str
    host: str
    port: int


def receivers(fleet: Fleet, targets: Mapping[str, Target]) -> tuple[Receiver, ...]:
    """Return the robots that are configured to receive their position from a feed. Raises WrongFiles.

    A robot of a squad is called SQUAD.ROBOT.
    """
    found = _own_receivers(fleet, targets)
    for squad, inner in fleet.inner_fleets.items():
        found += [replace(each, robot=f"{squad}.{each.robot}") for each in _own_receivers(inner, targets)]
    if not found:
        raise WrongFiles(
            "no robot of this fleet receives a position feed", "a quad receives a feed with `positioning: vision`"
        )
    return tuple(found)


def _own_receivers(fleet: Fleet, targets: Mapping[str, Target]) -> list[Receiver]:
    """Return the receivers of a fleet without those of its squads. Raises WrongFiles."""
    found = []
    for robot in fleet.robots:
        if robot.inner is not None:
            continue
        feed = targets[robot.target].feed
        if feed is None or any(robot.settings.get(key) == value for key, value in feed.unless.items()):
            continue
        kind, _, address = str(robot.settings[feed.setting]).partition(":")
        host, port = parse_address(address)
        if kind != "udp" or not port:
            raise WrongFiles(
                f"{robot.name}: {feed.setting} {robot.settings[feed.setting]!r} is not understood",
                "in the fleet file, write the address as udp:HOST:PORT, for example udp:0.0.0.0:47300",
            )
        found.append(Receiver(robot.name, robot.host if host == "0.0.0.0" else host, port))
    return found


class Forwarder:
    """Selector of the datagrams for each robot of one fleet. It uses no socket and no clock.

    `robots`: for the fleet of a squad, names SQUAD.ROBOT, as the bodies are called.
    `session` must be greater than in any earlier run, because agents refuse datagrams of older sessions.
    """

    def __init__(
        self, robots: tuple[str, ...], mocap: Mocap, key: bytes | None, session: int, rate: float, application: int = 0
    ) -> None:
        self._mocap, self._key, self._session, self._period = mocap, key, session, 1.0 / rate
        self._application = application
        self._sequence = 0
        self._last: dict[str, Body] = {}
        self._next = dict.fromkeys(robots, 0.0)
        self._seen = dict.fromkeys(robots, -LOST)
        self._sent = dict.fromkeys(robots, 0)
        self._places: dict[str, Vector] = {}
        self._foreign: dict[str, float] = {}

    def frame(self, bodies: Mapping[str, Body], measured: float, now: float) -> dict[str, bytes]:
        """Return the datagrams that are due, by robot, for a frame that arrived at `measured`.

        `measured` and `now` are seconds on one clock. A pose that equals the previous one bit by bit is ignored,
        because motion capture systems repeat the last pose of a body that they have lost.
        """
        due = {}
        for name, body in bodies.items():
            if name not in self._next:
                self._foreign[name] = now
            elif self._last.get(name) != body:
                self._last[name] = body
                pose = self._mocap.pose(*body)
                if pose is not None:
                    self._seen[name], self._places[name] = now, pose[0]
                    if now >= self._next[name] - _JITTER * self._period:
                        self._next[name] = max(self._next[name] + self._period, now)
                        due[name] = self._sealed(name, pose, measured, now)
        return due

    def _sealed(self, name: str, pose: tuple[Vector, float], measured: float, now: float) -> bytes:
        from koordgen.runtime.values.points import Point, Pose
        from koordgen.runtime.vehicle.feed import Sample, encode

        self._sequence += 1
        self._sent[name] += 1
        place = Pose(Point(*pose[0]), pose[1])
        own = name.rpartition(".")[2]
        sample = Sample(own, self._session, self._sequence, now, place, now - measured, self._application)
        return encode(sample, self._key)

    def summary(self, now: float, seconds: float) -> str:
        """Return a one-line summary of what was forwarded in the last `seconds`."""
        words = []
        for name, sent in self._sent.items():
            if now - self._seen[name] >= LOST:
                words.append(f"{name} NOT SEEN")
            else:
                x, y, z = self._places[name]
                words.append(f"{name} {sent / seconds:.0f}/s ({x:.2f}, {y:.2f}, {z:.2f})")
        self._sent = dict.fromkeys(self._sent, 0)
        strange = sorted(name for name, at in self._foreign.items() if now - at < LOST)
        return "  ".join(words) + (f"  not in the fleet: {', '.join(strange)}" if strange else "")


class Camera:
    """Reader of frames in a thread of its own, because `waitForNextFrame` cannot be interrupted.

    `frames` holds at most the two newest frames, or the error that ended the reading.
    """

    def __init__(self, system: Any, clock: Callable[[], float] = raw_clock) -> None:
        self._system, self._clock = system, clock
        self._ended = threading.Event()
        self.frames: queue.Queue[Frame | Exception] = queue.Queue(maxsize=2)
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        while not self._ended.is_set():
            try:
                self._system.waitForNextFrame()
                found: Frame | Exception = (self._clock(), _bodies(self._system.rigidBodies))
            except Exception as error:  # the libraries of motion capture systems may raise any exception
                found = error
            if self.frames.full():
                with suppress(queue.Empty):
                    self.frames.get_nowait()  # drop the oldest frame: only recent poses are useful
            self.frames.put(found)
            if isinstance(found, Exception):
                return

    def end(self) -> bool:
        """Stop reading. Return False if the system's library still blocks the thread after 1 s."""
        self._ended.set()
        self._thread.join(1.0)
        return not self._thread.is_alive()


def _bodies(found: Mapping[str, Any]) -> dict[str, Body]:
    bodies = {}
    for name, body in found.items():
        x, y, z = (float(v) for v in body.position)
        r = body.rotation
        bodies[str(name)] = ((x, y, z), (float(r.x), float(r.y), float(r.z), float(r.w)))
    return bodies


def connected(name: str, host: str) -> Any:
    """Return a connection to a motion capture system. Raises CannotServe."""
    try:
        import motioncapture

        import koordgen.runtime.vehicle.feed  # noqa: F401
    except ImportError as error:
        message = f"the Python package {error.name} is missing or does not load: {error}"
        raise CannotServe(message, pip_install("'koordgen[mocap]'")) from None
    try:
        return motioncapture.connect(name, {"hostname": host})
    except Exception as error:
        raise CannotServe(
            f"{name} at {host}: {error}", "check that the system is switched on and streams, and that its name is right"
        ) from None


class Station:
    """Base station: reads frames of one motion capture system and sends robots their poses.

    `forwarders`: one for each squad with receivers, and one for the other robots, "".
    Raises CannotServe.
    """

    def __init__(self, system: Any, forwarders: Mapping[str, Forwarder], to: tuple[Receiver, ...]) -> None:
        self._forwarders = forwarders
        self._addresses = {receiver.robot: _resolved(receiver) for receiver in to}
        self.camera = Camera(system)

    def serve(self, report: Callable[[str], None], clock: Callable[[], float] = raw_clock) -> None:
        """Send poses until the capture system fails; call `report` with a summary line each second.

        Raises CannotServe when the motion capture system fails.
        """
        said = clock()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.setblocking(False)
            while True:
                with suppress(queue.Empty):
                    self._pass_on(sender, self.camera.frames.get(timeout=_LOOK), clock)
                if (now := clock()) - said >= SUMMARY_EVERY:
                    report("  ".join([each.summary(now, now - said) for each in self._forwarders.values()]))
                    said = now

    def _pass_on(self, sender: socket.socket, found: Frame | Exception, clock: Callable[[], float]) -> None:
        if isinstance(found, Exception):
            raise CannotServe(f"the motion capture system failed: {found}", "repair it, then run the command again")
        measured, bodies = found
        of_squads: dict[str, dict[str, Body]] = {squad: {} for squad in self._forwarders}
        for name, body in bodies.items():
            squad = name.rpartition(".")[0]
            of_squads[squad if squad in of_squads else next(iter(of_squads))][name] = body
        for squad, forwarder in self._forwarders.items():
            for robot, datagram in forwarder.frame(of_squads[squad], measured, clock()).items():
                with suppress(OSError):  # the socket's buffer is full, or no agent listens at the robot's address yet
                    sender.sendto(datagram, self._addresses[robot])


def station(
    fleet: Fleet, path: str, key_path: str | None, name: str, host: str, rate: float, warn: Callable[[str], None]
) -> Station:
    """Return the base station for the fleet file `path` and the motion capture system `name` at `host`.

    Raises CannotServe.
    """
    to = receivers(fleet, all_targets())
    session = next_session(Path(path).parent / SESSION, time.time_ns() // 1_000_000, warn)
    own = {robot.name: robot for robot in physical_robots(fleet, path)}
    by_squad: dict[str, list[PhysicalRobot]] = {}
    for receiver in to:
        robot = own[receiver.robot]
        by_squad.setdefault(robot.squad, []).append(robot)
    forwarders = {}
    for squad, robots in by_squad.items():
        level = robots[0].fleet
        key = keyed(level, str(robots[0].file), None if squad else key_path)
        names = tuple([robot.name for robot in robots])
        forwarders[squad] = Forwarder(names, level.mocap, key, session, rate, level.application_id)
    return Station(connected(name, host), forwarders, to)


def next_session(path: Path, now: int, warn: Callable[[str], None]) -> int:
    """Return a session number greater than that of every earlier run, and record it in the file at `path`.

    The number is `now`, in milliseconds since 1970, or the recorded number plus one if that is greater (the clock
    was set back).
    """
    try:
        session = max(now, int(path.read_text()) + 1) if path.exists() else now
    except (OSError, ValueError):
        warn(f"warning: {path} cannot be read: agents that run refuse positions if this computer's clock is behind")
        session = now
    try:
        new = path.with_name(f"{path.name}.new")
        new.write_text(f"{session}\n")
        new.replace(path)
    except OSError as error:
        warn(f"warning: {path}: {error.strerror or error}: after the next start, agents may refuse positions")
    return session


def _resolved(receiver: Receiver) -> tuple[Any, ...]:
    try:
        return socket.getaddrinfo(receiver.host, receiver.port, socket.AF_INET, socket.SOCK_DGRAM)[0][4]
    except (OSError, UnicodeError) as error:
        raise CannotServe(
            f"{receiver.robot}: no address for {receiver.host}: {error}",
            "correct the robot's `address` in the fleet file",
        ) from None


def keyed(fleet: Fleet, path: str, key_path: str | None) -> bytes | None:
    """Return the fleet's key; None for a fleet without a key. Raises WrongFiles.

    The key is read from `key_path`, else from beside the fleet file, else from the working directory.
    """
    if not fleet.key and key_path is None:
        return None
    beside = Path(path).parent / fleet.key
    try:
        return load_key(Path(key_path) if key_path is not None else beside if beside.exists() else Path(fleet.key))
    except BadKey as error:
        raise WrongFiles(str(error), "name another key file with `--key FILE`") from None


def all_targets() -> dict[str, Target]:
    """Return all installed targets by name."""
    return {name: load(name) for name in available()}
