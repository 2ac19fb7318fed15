"""Datagrams of the control port between operators and agents: emergency stop and status.

A datagram consists of the byte `ORDER_FORMAT`, a byte for the kind, fields at fixed offsets, zeros up to the fixed
length, and the MAC of `seal`. This module needs only Python's standard library, so that any computer that has the key
can send a stop.

An emergency stop exchanges four datagrams: Ask, Offer with a challenge, Stop with this challenge, Stopped. A status
request exchanges Ask, Offer, AskStatus with the challenge, StatusPart. Only the agent that issued a challenge accepts
the challenge, for CHALLENGE_LIFE seconds; the secret for its verification is lost when the agent's process ends. So a
recorded Stop stops no robot, and a recorded AskStatus gets no answer. Each answer contains the random nonce of its
request, so recorded answers are not accepted either.

The formats of Ask, Offer, Stop and Stopped never change, because a new koordgen must be able to stop an old agent."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass

from koordgen.runtime.net.seal import CONTROL, MAC_SIZE, seal, unseal

ORDER_FORMAT = 1
# Lengths of sealed datagrams in bytes. A request is as long as its answer, so an agent cannot amplify a flood.
SHORT = 96
LONG = 1200  # length of an AskStatus, and largest length of its answer
NONCE = 8  # length of a nonce in bytes
CHALLENGE = 24  # length of a challenge in bytes
CHALLENGE_LIFE = 10.0  # seconds after its issue for which an agent accepts a challenge
_NAME = 32  # length of the field for a robot's name or an agent's phase, in bytes
_PART = struct.Struct("!BB8sHH")
PIECE = LONG - MAC_SIZE - _PART.size  # largest number of bytes of a status report in one datagram


@dataclass(frozen=True, slots=True)
class Ask:
    """Request for the name of the robot and for a challenge. A later Stop or AskStatus must contain the challenge."""

    application: int
    nonce: bytes


@dataclass(frozen=True, slots=True)
class Offer:
    nonce: bytes
    pid: int
    challenge: bytes
    robot: str


@dataclass(frozen=True, slots=True)
class StopOrder:
    nonce: bytes
    challenge: bytes


@dataclass(frozen=True, slots=True)
class StopAnswer:
    """Answer to Stop: the robot is stopping safely (`phase` is "stopping"), or has stopped ("stopped")."""

    nonce: bytes
    pid: int
    phase: str


@dataclass(frozen=True, slots=True)
class AskStatus:
    """Request for one piece of the status report. All pieces with one nonce belong to the same report."""

    application: int
    nonce: bytes
    challenge: bytes
    part: int


@dataclass(frozen=True, slots=True)
class StatusPart:
    nonce: bytes
    part: int
    parts: int
    data: bytes  # piece of the status report's JSON text


Order = Ask | Offer | StopOrder | StopAnswer | AskStatus | StatusPart

_ASK = struct.Struct("!BBH8s")
_OFFER = struct.Struct(f"!BB8sB{CHALLENGE}s{_NAME}s")
_STOP = struct.Struct(f"!BB8s{CHALLENGE}s")
_STOPPED = struct.Struct(f"!BB8sB{_NAME}s")
_ASK_STATUS = struct.Struct(f"!BBH8s{CHALLENGE}sH")
_KIND_OF_ASK_STATUS = 6  # in old versions kind 4 was an AskStatus without a challenge


def encode(order: Order, key: bytes | None) -> bytes:
    """Return a sealed datagram that contains the order."""
    f = ORDER_FORMAT
    length = SHORT
    match order:
        case Ask(application, nonce):
            payload = _ASK.pack(f, 0, application, nonce)
        case Offer(nonce, pid, challenge, robot):
            payload = _OFFER.pack(f, 1, nonce, pid, challenge, _cut(robot))
        case StopOrder(nonce, challenge):
            payload = _STOP.pack(f, 2, nonce, challenge)
        case StopAnswer(nonce, pid, phase):
            payload = _STOPPED.pack(f, 3, nonce, pid, _cut(phase))
        case AskStatus(application, nonce, challenge, part):
            payload = _ASK_STATUS.pack(f, _KIND_OF_ASK_STATUS, application, nonce, challenge, part)
            length = LONG
        case StatusPart(nonce, part, parts, data):
            payload, length = _PART.pack(f, 5, nonce, part, parts) + data, 0
    return seal(key, CONTROL, payload.ljust(length - MAC_SIZE, b"\0"))


def decode(datagram: bytes, key: bytes | None) -> Order | str:
    """Return the order in a datagram, or the reason to refuse the datagram.

    The order is read only after the MAC is verified. This function never raises."""
    if len(datagram) > LONG:
        return "oversize"
    payload = unseal(key, CONTROL, datagram)
    if payload is None:
        return "not authentic"
    if payload[0] != ORDER_FORMAT:
        return "another format version"
    kind = payload[1] if len(payload) > 1 else -1
    if kind == 5:
        if len(payload) < _PART.size:
            return "malformed"
        _, _, nonce, part, parts = _PART.unpack_from(payload)
        return StatusPart(nonce, part, parts, payload[_PART.size :])
    reader = _READERS.get(kind)
    if reader is None or len(datagram) != (LONG if kind == _KIND_OF_ASK_STATUS else SHORT):
        return "malformed"
    return reader(payload)


def _cut(text: str) -> bytes:
    return text.encode("utf-8", "replace")[:_NAME]


def _text(raw: bytes) -> str:
    return raw.rstrip(b"\0").decode("utf-8", "replace")


def _offer(payload: bytes) -> Offer:
    _, _, nonce, pid, challenge, robot = _OFFER.unpack_from(payload)
    return Offer(nonce, pid, challenge, _text(robot))


def _stopped(payload: bytes) -> StopAnswer:
    _, _, nonce, pid, phase = _STOPPED.unpack_from(payload)
    return StopAnswer(nonce, pid, _text(phase))


_READERS: dict[int, Callable[[bytes], Order]] = {
    0: lambda payload: Ask(*_ASK.unpack_from(payload)[2:]),
    1: _offer,
    2: lambda payload: StopOrder(*_STOP.unpack_from(payload)[2:]),
    3: _stopped,
    _KIND_OF_ASK_STATUS: lambda payload: AskStatus(*_ASK_STATUS.unpack_from(payload)[2:]),
}
