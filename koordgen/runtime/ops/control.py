"""Control port of an agent: emergency stop and status for operators who have the fleet's key."""

from __future__ import annotations

import json
import os
import socket
from collections.abc import Callable, Mapping
from contextlib import suppress
from hashlib import blake2s
from hmac import compare_digest
from typing import Any, Protocol

from koordgen.runtime.config.settings import Settings
from koordgen.runtime.net.transport import CannotOpen
from koordgen.runtime.ops.orders import (
    CHALLENGE_LIFE,
    LONG,
    PIECE,
    Ask,
    AskStatus,
    Offer,
    Order,
    StatusPart,
    StopAnswer,
    StopOrder,
    decode,
    encode,
)

MOST_AT_ONCE = 256  # largest number of datagrams handled in one poll: a flood of datagrams costs about 1 ms a poll
LINGER = 1.0  # seconds after a stop command in which the command's sender may still wait for the answer
MOST_ASKERS = 4  # largest number of status requests that are answered at the same time

Report = Callable[[], Mapping[str, Any]]


class Datagrams(Protocol):
    """Socket for datagrams whose methods never block and never raise an exception."""

    def receive(self) -> tuple[bytes, Any] | None:
        """Return the next datagram and the address of its sender, or None if no datagram has arrived."""
        ...

    def send(self, datagram: bytes, address: Any) -> None: ...

    def close(self) -> None: ...


class ControlSocket:
    """UDP socket on the robot's control port. Raises CannotOpen."""

    def __init__(self, settings: Settings) -> None:
        family, address = address_of(settings)
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            self._socket.bind(address)
        except OSError as error:
            self._socket.close()
            raise CannotOpen(
                f"{address[0]}:{address[1]}, the control port of robot {settings.robot}: {error.strerror or error}; "
                "set another `control` port for this robot, in the fleet file or in the robot's settings"
            ) from None

    def receive(self) -> tuple[bytes, Any] | None:
        for _ in range(2):  # the first try may raise the error of an earlier answer (ECONNREFUSED)
            try:
                return self._socket.recvfrom(LONG + 1)
            except BlockingIOError:
                return None
            except OSError:
                continue
        return None

    def send(self, datagram: bytes, address: Any) -> None:
        with suppress(OSError):
            self._socket.sendto(datagram, address)

    def close(self) -> None:
        self._socket.close()


class Control:
    """Handler of the requests that arrive on the control port. The agent's loop calls `poll` in every turn.

    secret: 32 random bytes, new for every start of the process.
    rejected: reason -> number of refused datagrams.
    A datagram has no effect before its MAC is verified. Each authentic request is answered by at most one datagram,
    which is not longer than the request, so an attacker cannot use the agent to amplify a flood."""

    def __init__(self, sockets: Datagrams, settings: Settings, key: bytes | None, secret: bytes) -> None:
        self.rejected: dict[str, int] = {}
        self._sockets = sockets
        self._application = settings.application_id
        self._pid = settings.pid
        self._robot = settings.robot
        self._key = key
        self._secret = secret
        self._stopped_at: float | None = None
        self._status: dict[bytes, bytes] = {}  # nonce of a request -> status report; only the newest requests

    @staticmethod
    def open(settings: Settings, key: bytes | None) -> Control:
        """Open the robot's control port. Raises CannotOpen."""
        return Control(ControlSocket(settings), settings, key, os.urandom(32))

    def poll(self, now: float, phase: str, report: Report) -> bool:
        """Handle at most MOST_AT_ONCE datagrams. Return whether a stop was commanded in this call or an earlier one.

        now: local time in seconds.
        phase: phase of the agent.
        report: creates the agent's status report. It is called at most once.
        This method never blocks and never raises."""
        reported = False
        for _ in range(MOST_AT_ONCE):
            arrived = self._sockets.receive()
            if arrived is None:
                break
            datagram, address = arrived
            answer: Order | str
            match decode(datagram, self._key):
                case str() as reason:
                    answer = reason
                case Ask(application) | AskStatus(application) if application != self._application:
                    answer = "another application"
                case Ask(_, nonce):
                    answer = Offer(nonce, self._pid, self._challenge(now), self._robot)
                case StopOrder(nonce, challenge):
                    answer = self._stop(nonce, challenge, phase, now)
                case AskStatus(_, _, challenge, _) if flaw := self._flaw(challenge, now):
                    answer = flaw
                case AskStatus(_, nonce, _, part):
                    new = nonce not in self._status
                    answer = "too many questions" if new and reported else self._part(nonce, part, report)
                    reported = reported or new
                case _:
                    answer = "an answer to nobody"
            if isinstance(answer, str):
                self.rejected[answer] = self.rejected.get(answer, 0) + 1
            else:
                self._sockets.send(encode(answer, self._key), address)
        return self._stopped_at is not None

    def lingers(self, now: float) -> bool:
        """Return whether the sender of a stop command may still wait for an answer. The process must not end then."""
        return self._stopped_at is not None and now - self._stopped_at < LINGER

    def close(self) -> None:
        self._sockets.close()

    def _challenge(self, now: float) -> bytes:
        return self._signed(max(0, int(now * 1e6)).to_bytes(8, "big"))

    def _signed(self, issued: bytes) -> bytes:
        return issued + blake2s(issued, digest_size=16, key=self._secret).digest()

    def _flaw(self, challenge: bytes, now: float) -> str:
        """Return the reason to refuse a challenge; "" if this process issued the challenge recently."""
        if not compare_digest(self._signed(challenge[:8]), challenge):
            return "not our challenge"
        if now - int.from_bytes(challenge[:8], "big") / 1e6 > CHALLENGE_LIFE:
            return "an old challenge"
        return ""

    def _stop(self, nonce: bytes, challenge: bytes, phase: str, now: float) -> StopAnswer | str:
        """Handle a stop command and return the answer. Only the first stop command has an effect."""
        if flaw := self._flaw(challenge, now):
            return flaw
        if self._stopped_at is None:
            self._stopped_at = now
        return StopAnswer(nonce, self._pid, phase if phase in ("stopping", "stopped") else "stopping")

    def _part(self, nonce: bytes, part: int, report: Report) -> StatusPart | str:
        if nonce not in self._status:
            try:
                self._status[nonce] = json.dumps(report()).encode()
            except Exception:  # an error in the status report must not end the agent
                return "no report can be made"
            if len(self._status) > MOST_ASKERS:
                del self._status[next(iter(self._status))]
        text = self._status[nonce]
        parts = -(-len(text) // PIECE)
        if part >= parts:
            return "no such part"
        return StatusPart(nonce, part, parts, text[part * PIECE : (part + 1) * PIECE])


def address_of(settings: Settings) -> tuple[socket.AddressFamily, tuple[str, int]]:
    """Return the address of the robot's control port. Raises CannotOpen."""
    host = settings.bind or settings.peers[settings.pid].host
    try:
        found = socket.getaddrinfo(host, settings.control_port, type=socket.SOCK_DGRAM)
    except (OSError, UnicodeError, OverflowError) as error:
        raise CannotOpen(f"robot {settings.robot}: no address for {host}: {error}") from None
    family, _, _, _, address = found[0]
    return family, (str(address[0]), int(address[1]))
