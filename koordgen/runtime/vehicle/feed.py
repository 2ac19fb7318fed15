"""Position feed: poses of a robot that a base station (motion capture, or the simulator) measures and sends.

Each sample is one sealed MessagePack datagram. `Sample` lists its fields, docs/reference/wire.md its bytes. Sequence
numbers only grow within a session (one run of the base station), so an old sample is never accepted as a new one. The
transit time of each sample is compared with the shortest transit time of the session, so even a slowly growing delay is
detected. A delay that all samples of a session have in common cannot be detected."""

from __future__ import annotations

import math
from collections.abc import Callable

import msgspec

from koordgen.runtime.net.seal import POSITION, seal, unseal
from koordgen.runtime.values.points import Pose
from koordgen.runtime.vehicle.datagrams import DatagramLink, UdpLink, even_clock, listen

FARTHEST = 100_000.0  # largest valid coordinate in metres, and largest valid yaw in radians
LATEST = 1e12  # largest valid time of a sender's clock in seconds
DRIFT = 200e-6  # largest relative drift between the clocks of two computers: each crystal is within 100 ppm
OVERTAKEN = 100  # a warning is logged after this number of consecutive samples of an earlier session
_HINT = "start the base station; check that it knows this robot's name, address and the fleet's key"


class Sample(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """One measured pose.

    `robot`: name of the robot in the fleet file. `pose`: metres and radians in local ENU. `sent`: time of sending in
    seconds of the sender's clock, which is steady within a session. `age`: seconds between measurement and sending.
    `application`: the fleet's application_id."""

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
    """Return a sealed datagram that contains one sample."""
    return seal(key, POSITION, _encoder.encode(sample))


class Transit:
    """Estimator of the difference between the sender's clock and the robot's clock.

    The datagram with the shortest transit time in a session is assumed to have had no delay. The delay of every other
    datagram is its transit time minus the shortest one. The estimated difference of the clocks grows at most at the
    rate DRIFT, so a delay that grows faster is not mistaken for clock drift."""

    def __init__(self) -> None:
        self._least = math.inf  # the robot's clock minus the sender's clock, in seconds
        self._last = -math.inf  # time when the last datagram arrived

    def arrived(self, sent: float, now: float) -> float:
        """Return the time on the robot's clock at which a datagram was sent, at most `now`.

        `sent`: time of sending on the sender's clock. `now`: time of arrival on the robot's clock."""
        self._least = min(self._least + DRIFT * max(0.0, now - self._last), now - sent)
        self._last = now
        return min(now, sent + self._least)


class Feed:
    """Receiver of one robot's position samples. No datagram causes an exception.

    rejected: reason -> number of dropped datagrams.
    pose: pose of the newest sample; None before the first sample.
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
        """Select the clock that stamps the samples of a link: the raw clock for a real socket."""
        self._even = even_clock(link)

    def receive(self, datagram: bytes, now: float) -> bool:
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

    def log_lines(self) -> list[str]:
        """Return log lines since the last call: a warning if a base station sends samples of an earlier session."""
        if self._overtaken < OVERTAKEN:
            return []
        self._overtaken = -(10 * OVERTAKEN)  # the warning is repeated only after 11 * OVERTAKEN more samples
        return [
            f"{OVERTAKEN} positions were refused: they belong to an earlier run of the base station than the positions "
            f"received before (session {self._session}). Stop other base stations. If the clock of the base station's "
            "computer is behind, set the clock and start the base station again, or restart this agent"
        ]

    def reject(self, reason: str) -> bool:
        """Count a dropped datagram by its reason. Return False, which `receive` then returns."""
        self.rejected[reason] = self.rejected.get(reason, 0) + 1
        return False

    @property
    def dropped(self) -> str:
        """End of a message that lists the dropped datagrams by reason; "" if no datagram was dropped."""
        told = ", ".join(f"{_about(n)} {why}" for why, n in self.rejected.items())
        return f"; dropped: {told}" if told else ""

    def silent(self, setting: str, seconds: float) -> tuple[str, str]:
        """Return message and hint of the Unready to raise if no sample has arrived on `setting` for `seconds`."""
        return f"no position has arrived on {setting} for {seconds:.0f} s{self.dropped}", _HINT


def _about(n: int) -> str:
    """Round a large count down to a power of ten, so that a logged text does not change with every datagram."""
    return str(n) if n < 100 else f"{10 ** (len(str(n)) - 1)}+"


def listen_for_poses(key: str, setting: str) -> UdpLink:
    """Bind the port of a position feed. `setting` is the value of the robot's setting `key`. Raises Unready."""
    return listen(key, setting, "positions", "the base station", "udp:0.0.0.0:47300")
