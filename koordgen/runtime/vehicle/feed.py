"""Position feed.

A robot's own pose, measured and sent by a base station (motion capture, or the simulator).

One sealed MessagePack datagram per sample; see `Sample` for its fields and docs/reference/wire.md for the bytes.
Sequence numbers only grow within a session (one run of the base station), so an old sample never passes for a new one.
The transit time of a sample is compared with the shortest one of its session, so a growing delay is detected, however
slow. A delay common to all samples of a session cannot be detected."""

from __future__ import annotations

import math
from collections.abc import Callable

import msgspec

from koordgen.runtime.net.seal import POSITION, seal, unseal
from koordgen.runtime.values.points import Pose
from koordgen.runtime.vehicle.datagrams import DatagramLink, UdpLink, even_clock, listen

FARTHEST = 100_000.0  # metres from the origin, and radians of yaw: larger values are invalid
LATEST = 1e12  # seconds on a sender's clock; larger values are invalid
DRIFT = 200e-6  # largest relative drift of two computers' clocks: crystals are within 100 ppm
OVERTAKEN = 100  # consecutive samples of an earlier session after which a warning is logged
_HINT = "start the base station; check that it knows this robot's name, address and the fleet's key"


class Sample(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """One measured pose.

    `robot`: its name in the fleet file. `pose`: metres and radians in local ENU. `sent`: time of sending (seconds on
    the sender's clock, steady within a session). `age`: seconds between measurement and sending. `application`: the
    fleet's application_id."""

    robot: str
    session: int
    sequence: int
    sent: float
    pose: Pose
    age: float = 0.0
    application: int = 0


_encoder = msgspec.msgpack.Encoder()
_decoder = msgspec.msgpack.Decoder(Sample)


def encode(sample: Sample, key: bytes | None) -> bytes:
    """Return a datagram with one sample."""
    return seal(key, POSITION, _encoder.encode(sample))


class Transit:
    """Estimator of the sender's clock by the shortest transit time.

    The datagram with the shortest transit in a session is assumed to have had no delay. The delay of every other
    datagram is the difference of the two transit times. The estimated difference of the clocks grows at the rate DRIFT
    at most, so a growing delay is not mistaken for clock drift."""

    def __init__(self) -> None:
        self._least = math.inf  # own clock minus the sender's
        self._last = -math.inf  # time when the last datagram arrived

    def arrived(self, sent: float, now: float) -> float:
        """Return when a datagram was sent, on the own clock; not later than `now`."""
        self._least = min(self._least + DRIFT * max(0.0, now - self._last), now - sent)
        self._last = now
        return min(now, sent + self._least)


class Feed:
    """Receiver of one robot's samples. No datagram causes an exception.

    rejected: number of dropped datagrams by reason.
    pose: the last pose.
    time: time at which that pose was measured, in seconds of the robot's clock.
    """

    def __init__(self, robot: str, key: bytes | None, application: int = 0) -> None:
        self._robot = robot
        self._key = key
        self._application = application
        self._session = 0
        self._sequence = -1
        self._transit = Transit()
        self._even: Callable[[], float] | None = None
        self._overtaken = 0  # samples of an earlier session since the last accepted one
        self.rejected: dict[str, int] = {}
        self.pose: Pose | None = None
        self.time: float | None = None

    def hear(self, link: DatagramLink) -> None:
        """Stamp the samples of this link: by the raw clock for a real socket."""
        self._even = even_clock(link)

    def take(self, datagram: bytes, now: float) -> bool:
        """Handle a datagram that arrived at `now`. Return whether it brought a newer pose."""
        payload = unseal(self._key, POSITION, datagram)
        if payload is None:
            return self.reject("not authentic")
        try:
            sample = _decoder.decode(payload)
        except (ValueError, RecursionError):
            return self.reject("malformed")
        p = sample.pose.position
        numbers = (p.x, p.y, p.z, sample.pose.yaw)
        if not all(map(math.isfinite, (*numbers, sample.sent, sample.age))):
            return self.reject("not finite")
        if max(map(abs, numbers)) > FARTHEST or abs(sample.sent) > LATEST:
            return self.reject("out of range")
        if sample.robot != self._robot:
            return self.reject("another robot's")
        if sample.application != self._application:
            return self.reject("another application")
        if sample.session < self._session or (sample.session == self._session and sample.sequence <= self._sequence):
            self._overtaken += sample.session < self._session
            return self.reject("old")
        if sample.session != self._session:
            self._transit = Transit()
        self._session, self._sequence, self._overtaken = sample.session, sample.sequence, 0
        even = now if self._even is None else self._even()
        delay = even - self._transit.arrived(sample.sent, even)
        self.pose, self.time = sample.pose, now - delay - max(0.0, sample.age)
        return True

    def news(self) -> list[str]:
        """Return new log lines: a warning if a base station sends samples of an earlier session."""
        if self._overtaken < OVERTAKEN:
            return []
        self._overtaken = -(10 * OVERTAKEN)  # repeated after as many more
        return [
            f"{OVERTAKEN} positions were refused: they are of an earlier run of the base station than one received "
            f"before (session {self._session}). Does another base station run, or is its computer's clock behind? Set "
            "that clock and start the base station again, or restart this agent"
        ]

    def reject(self, reason: str) -> bool:
        """Count a dropped datagram. Return False, for the caller to return."""
        self.rejected[reason] = self.rejected.get(reason, 0) + 1
        return False

    @property
    def dropped(self) -> str:
        """Dropped datagrams as text to append to a message; "" if there are none."""
        told = ", ".join(f"{_about(n)} {why}" for why, n in self.rejected.items())
        return f"; dropped: {told}" if told else ""

    def silent(self, setting: str, seconds: float) -> tuple[str, str]:
        """Return message and hint of the Unready after a silence of `seconds` on `setting`."""
        return f"no position has arrived on {setting} for {seconds:.0f} s{self.dropped}", _HINT


def _about(n: int) -> str:
    """Round a large count: a logged text must not change with each datagram of a flood."""
    return str(n) if n < 100 else f"{10 ** (len(str(n)) - 1)}+"


def listen_for_poses(key: str, setting: str) -> UdpLink:
    """Bind the port of a position feed, which the robot's setting `key` names. Raises Unready."""
    return listen(key, setting, "positions", "the base station", "udp:0.0.0.0:47300")
