"""The position feed: what a base station (motion capture, or the simulator) tells a robot about its own pose.

One sealed MessagePack datagram a sample; see `Sample` for its fields. Sequence numbers only grow within a session
(one run of the base station), so an old sample is never taken for a new one.
"""

from __future__ import annotations

import math

import msgspec

from koordgen.runtime.seal import POSITION, seal, unseal
from koordgen.runtime.values import Pose


class Sample(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """One measured pose: `robot` by its name in the fleet file, metres and radians in local ENU, and `age`, the
    seconds between the measurement and the sending."""

    robot: str
    session: int
    sequence: int
    pose: Pose
    age: float = 0.0


_encoder = msgspec.msgpack.Encoder()
_decoder = msgspec.msgpack.Decoder(Sample)


def encode(sample: Sample, key: bytes | None) -> bytes:
    """A datagram that carries one sample."""
    return seal(key, POSITION, _encoder.encode(sample))


class Feed:
    """Receives one robot's samples. `rejected` counts what was dropped, by reason; nothing received ever raises."""

    def __init__(self, robot: str, key: bytes | None) -> None:
        self._robot = robot
        self._key = key
        self._session = 0
        self._sequence = -1
        self.rejected: dict[str, int] = {}
        self.pose: Pose | None = None
        self.time: float | None = None

    def take(self, datagram: bytes, now: float) -> bool:
        """Take a datagram that arrived at `now`; True when it brought a newer pose."""
        payload = unseal(self._key, POSITION, datagram)
        if payload is None:
            return self._reject("not authentic")
        try:
            sample = _decoder.decode(payload)
        except (ValueError, RecursionError):
            return self._reject("malformed")
        position = sample.pose.position
        if not all(map(math.isfinite, (position.x, position.y, position.z, sample.pose.yaw, sample.age))):
            return self._reject("not finite")
        if sample.robot != self._robot:
            return self._reject("another robot's")
        if sample.session < self._session or (sample.session == self._session and sample.sequence <= self._sequence):
            return self._reject("old")
        self._session, self._sequence = sample.session, sample.sequence
        self.pose, self.time = sample.pose, now - max(0.0, sample.age)
        return True

    def _reject(self, reason: str) -> bool:
        self.rejected[reason] = self.rejected.get(reason, 0) + 1
        return False
