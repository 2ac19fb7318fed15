"""The position feed: what a base station (motion capture, or the simulator) tells a robot about its own pose.

One sealed MessagePack datagram a sample; see `Sample` for its fields and docs/feeds.md for the bytes. Sequence numbers
only grow within a session (one run of the base station), so an old sample is never taken for a new one.
"""

from __future__ import annotations

import math

import msgspec

from koordgen.runtime.datagrams import UdpLink, listen
from koordgen.runtime.seal import POSITION, seal, unseal
from koordgen.runtime.values import Pose

FARTHEST = 100_000.0  # metres from the origin, and radians of yaw: more is no pose of a robot
WINDOW = 2.0  # seconds; clocks that drift apart by 100 ppm err by less than half a millisecond in two of it
_HINT = "start the base station; check that it knows this robot's name, address and the fleet's key"


class Sample(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """One measured pose: `robot` by its name in the fleet file, metres and radians in local ENU; `sent` is when it was
    sent (seconds on the sender's clock, which runs on evenly within a session), and `age` the seconds between the
    measurement and the sending."""

    robot: str
    session: int
    sequence: int
    sent: float
    pose: Pose
    age: float = 0.0


_encoder = msgspec.msgpack.Encoder()
_decoder = msgspec.msgpack.Decoder(Sample)


def encode(sample: Sample, key: bytes | None) -> bytes:
    """A datagram that carries one sample."""
    return seal(key, POSITION, _encoder.encode(sample))


class Transit:
    """Brings the sender's clock to ours: what has the shortest way of the last seconds is taken to have had none. So a
    datagram that was held up on its way is as old as it is, and none is younger."""

    def __init__(self) -> None:
        self._least = self._before = math.inf  # our clock minus theirs, in the present window and in the one before
        self._since = -math.inf

    def arrived(self, sent: float, now: float) -> float:
        """When a datagram was sent, on our clock; not later than `now`."""
        if now - self._since > WINDOW:
            self._before, self._least, self._since = self._least, math.inf, now
        self._least = min(self._least, now - sent)
        return min(now, sent + min(self._least, self._before))


class Feed:
    """Receives one robot's samples. `rejected` counts what was dropped, by reason; nothing received ever raises.
    `time` is when `pose` was true, seconds on our clock."""

    def __init__(self, robot: str, key: bytes | None) -> None:
        self._robot = robot
        self._key = key
        self._session = 0
        self._sequence = -1
        self._transit = Transit()
        self.rejected: dict[str, int] = {}
        self.pose: Pose | None = None
        self.time: float | None = None

    def take(self, datagram: bytes, now: float) -> bool:
        """Take a datagram that arrived at `now`; True when it brought a newer pose."""
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
        if max(map(abs, numbers)) > FARTHEST:
            return self.reject("out of range")
        if sample.robot != self._robot:
            return self.reject("another robot's")
        if sample.session < self._session or (sample.session == self._session and sample.sequence <= self._sequence):
            return self.reject("old")
        if sample.session != self._session:
            self._transit = Transit()
        self._session, self._sequence = sample.session, sample.sequence
        self.pose, self.time = sample.pose, self._transit.arrived(sample.sent, now) - max(0.0, sample.age)
        return True

    def reject(self, reason: str) -> bool:
        """Count what is dropped; False, for the caller to return."""
        self.rejected[reason] = self.rejected.get(reason, 0) + 1
        return False

    @property
    def dropped(self) -> str:
        """What was dropped, in words, to follow a message; "" when nothing was."""
        told = ", ".join(f"{_about(n)} {why}" for why, n in self.rejected.items())
        return f"; dropped: {told}" if told else ""

    def silent(self, setting: str, seconds: float) -> tuple[str, str]:
        """Message and hint of the Unready when nothing has come on `setting` for so long."""
        return f"no position has arrived on {setting} for {seconds:.0f} s{self.dropped}", _HINT


def _about(n: int) -> str:
    """Large counts roughly: a text that is told when it changes must not change with each datagram of a flood."""
    return str(n) if n < 100 else f"{10 ** (len(str(n)) - 1)}+"


def listen_for_poses(key: str, setting: str) -> UdpLink:
    """Bind the port of a position feed, which the robot's setting `key` names. Raises Unready."""
    return listen(key, setting, "positions", "the base station", "udp:0.0.0.0:47300")
