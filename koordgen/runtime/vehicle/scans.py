"""Scan feed: lidar scans that a driver (or the simulator) sends to a robot.

Each turn of the lidar is one sealed MessagePack datagram; `Sweep` lists its fields. Sequence numbers only grow within a
session (one run of the driver). A scan stays visible for `WINDOW` seconds after it was measured, because a robot may
read scans several times in a round."""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Callable, Sequence

import msgspec

from koordgen.runtime.net.seal import SCAN, seal, unseal
from koordgen.runtime.values.points import Point, Scan
from koordgen.runtime.vehicle.datagrams import DatagramLink, UdpLink, listen, waiting
from koordgen.runtime.vehicle.platform import Finding, Unready

WINDOW = 0.5  # seconds for which a scan stays visible
FIRST_SAMPLE_TIMEOUT = 60.0  # seconds to wait for the first scan: the lidar's driver may be started after the robot
MOST_SCANS = 4  # number of scans kept; older scans are dropped
MOST_RAYS = 512  # largest number of rays in one turn, so that a turn fits into a datagram of 1200 bytes
FARTHEST = 1000.0  # largest accepted range of a lidar in metres
NOTHING = 0xFFFF  # encoded range of a ray without a hit
_TURNS = 100.0  # largest valid angle of a ray in radians
_HINT = "start the lidar's driver; check that it knows this robot's name, address and the fleet's key"

Seen = tuple[Point, Scan]
Bind = Callable[[str], DatagramLink]


class Sweep(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """One turn of the lidar of robot `robot`, measured at `position` (metres, local ENU).

    Ray i points to `first + i * step` radians, counter-clockwise from east; the driver has already added the robot's
    heading. `ranges`: unsigned 16-bit numbers, little-endian, in units of `max_range` (metres) / 65535; 65535 means
    that the ray hit nothing. `age`: seconds between measurement and sending."""

    robot: str
    session: int
    sequence: int
    position: Point
    first: float
    step: float
    max_range: float
    ranges: bytes
    age: float = 0.0


_encoder = msgspec.msgpack.Encoder()
_decoder = msgspec.msgpack.Decoder(Sweep)


def packed(ranges: Sequence[float], max_range: float) -> bytes:
    """Encode ranges in metres as bytes for `Sweep.ranges`. A range of `max_range` or more denotes a ray without hit."""
    numbers = (
        NOTHING if r >= max_range else min(NOTHING - 1, round(max(0.0, r) / max_range * NOTHING)) for r in ranges
    )
    return struct.pack(f"<{len(ranges)}H", *numbers)


def encode(sweep: Sweep, key: bytes | None) -> bytes:
    """Return a sealed datagram that contains one turn of the lidar."""
    return seal(key, SCAN, _encoder.encode(sweep))


class Scans:
    """Receiver of one robot's lidar scans. No datagram causes an exception.

    `rejected`: reason -> number of dropped datagrams."""

    def __init__(self, robot: str, key: bytes | None) -> None:
        self._robot = robot
        self._key = key
        self._session = 0
        self._sequence = -1
        self._seen: deque[tuple[float, Seen]] = deque(maxlen=MOST_SCANS)
        self.rejected: dict[str, int] = {}

    @property
    def heard(self) -> bool:
        """True if at least one scan has arrived."""
        return self._sequence >= 0

    def receive(self, datagram: bytes, now: float) -> bool:
        """Handle a datagram that arrived at `now`. Return whether it contained a newer turn of the lidar."""
        payload = unseal(self._key, SCAN, datagram)
        if payload is None:
            return self._reject("not authentic")
        try:
            sweep = _decoder.decode(payload)
        except (ValueError, RecursionError):
            return self._reject("malformed")
        if not _sound(sweep):
            return self._reject("out of range")
        if sweep.robot != self._robot:
            return self._reject("another robot's")
        if sweep.session < self._session or (sweep.session == self._session and sweep.sequence <= self._sequence):
            return self._reject("old")
        self._session, self._sequence = sweep.session, sweep.sequence
        self._seen.append((now - max(0.0, sweep.age), (sweep.position, _scan(sweep))))
        return True

    def recent(self, now: float) -> tuple[Seen, ...]:
        """Return the scans of the last WINDOW seconds with the positions of their measurement, the newest last."""
        return tuple(seen for time, seen in self._seen if now - time <= WINDOW)

    def _reject(self, reason: str) -> bool:
        self.rejected[reason] = self.rejected.get(reason, 0) + 1
        return False


class ScanPort:
    """Port that receives the scans of one robot.

    `setting`: the robot's setting `scans`, "udp:HOST:PORT"; "" if the robot has no lidar."""

    def __init__(self, setting: str, robot: str, key: bytes | None, bind: Bind | None = None) -> None:
        """Create the port without binding it. `bind` opens the port that a setting names."""
        self._setting = setting
        self._bind = bind or listen_for_scans
        self._link: DatagramLink | None = None
        self._began: float | None = None  # time of the first poll
        self._patient = True
        self.scans = Scans(robot, key)

    def open(self) -> None:
        """Bind the port of the setting, unless it is bound already or the robot has no lidar. Raises Unready."""
        if not self._setting or self._link is not None:
            return
        self._link = self._bind(self._setting)

    def poll(self, now: float) -> None:
        """Handle all datagrams that have arrived.

        Raises Unready if the first scan does not arrive within FIRST_SAMPLE_TIMEOUT seconds. Raises it only
        once, because the agent goes on polling during the safe stop."""
        if self._link is None:
            return
        for datagram in waiting(self._link):
            self.scans.receive(datagram, now)
        self._began = now if self._began is None else self._began
        if self.waiting and self._patient and now - self._began > FIRST_SAMPLE_TIMEOUT:
            self._patient = False
            raise Unready(f"{self.waiting}, but none has come for {now - self._began:.0f} s", _HINT)

    @property
    def waiting(self) -> str:
        """Message that the robot waits for its first scan; "" if a scan has arrived or the robot has no lidar."""
        if not self._setting or self.scans.heard:
            return ""
        rejected = ", ".join(f"{n} {why}" for why, n in self.scans.rejected.items())
        return f"waiting for scans on {self._setting}" + (f"; dropped: {rejected}" if rejected else "")

    def diagnose(self, wait: Callable[[float], None]) -> list[Finding]:
        """Check whether a scan arrives within WINDOW seconds, for `diagnose` of a platform. A robot without lidar: [].

        `wait` waits for a number of seconds. A lidar that turns more slowly often has no visible scan, so it fails."""
        if not self._setting:
            return []
        try:
            self.open()
            for _ in range(10):
                self.poll(0.0)
                if self.scans.heard:
                    return [Finding("scans", "ok", f"arrive on {self._setting}")]
                wait(WINDOW / 10)
        except Unready as error:
            return [Finding.of("scans", error)]
        finally:
            self.close()
        return [Finding("scans", "fail", f"{self.waiting}, but none has come", f"one within {WINDOW:g} s", _HINT)]

    def close(self) -> None:
        """Close the port of the scans. Idempotent."""
        if self._link is not None:
            self._link.close()
            self._link = None


def listen_for_scans(setting: str) -> UdpLink:
    """Bind the port that a robot's setting `scans` names. Raises Unready."""
    example = "udp:0.0.0.0:47400; remove the setting if the robot has no lidar"
    return listen("scans", setting, "scans", "the lidar's driver", example)


def _sound(sweep: Sweep) -> bool:
    """Return whether all numbers of a lidar's turn are in range, and their count too. NaN is out of range."""
    p = sweep.position
    return (
        all(map(math.isfinite, (p.x, p.y, p.z, sweep.age)))
        and abs(sweep.first) <= _TURNS
        and abs(sweep.step) <= _TURNS
        and 0.0 < sweep.max_range <= FARTHEST
        and len(sweep.ranges) % 2 == 0
        and 2 <= len(sweep.ranges) <= 2 * MOST_RAYS
    )


def _scan(sweep: Sweep) -> Scan:
    numbers = struct.unpack(f"<{len(sweep.ranges) // 2}H", sweep.ranges)
    unit = sweep.max_range / NOTHING
    return Scan(
        tuple(sweep.first + i * sweep.step for i in range(len(numbers))),
        tuple(sweep.max_range if n == NOTHING else n * unit for n in numbers),
        sweep.max_range,
    )
