"""`koordgen estop`: stops a whole fleet, all robots at once, and tells of each what became of it.

A robot is called every few milliseconds until it answers or time is up. Whatever of the fleet file can be read is used:
a mistake elsewhere must not keep anyone from stopping.
"""

from __future__ import annotations

import json
import os
import socket
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import yaml

from koordgen.node import Node
from koordgen.robots import control_port, parse_address
from koordgen.runtime.orders import NONCE, SHORT, Ask, Offer, Stop, Stopped, decode, encode
from koordgen.runtime.seal import KEY_SIZE, BadKey, load_key

BY_HAND = "stop them by hand, now: remote control, kill switch, or cut their power"
NO_ANSWER = "no answer"
PATIENCE = 3.0  # seconds
STALE_OFFER = 0.3  # seconds after which an unanswered challenge is asked for anew: the agent may have been restarted
_SHORTEST, _EACH = 0.01, 0.0005  # seconds between two calls of a robot, of a fleet of 20 or less; and for each robot


class Place(Node):
    """Where a robot takes orders; port 0 when the fleet file does not tell."""

    name: str
    host: str
    port: int


class Called(Node):
    """What became of one robot's stop. `phase` is the agent's, empty without an answer; `after` in seconds; `note`
    says why there was none, or what is odd about it."""

    place: Place
    phase: str
    after: float
    note: str


class CannotStop(Exception):
    """Nobody was called at all: the fleet file or the key cannot be used."""

    def __init__(self, message: str, help: str = "") -> None:
        super().__init__(message)
        self.help = help


class Fleet(Node):
    """`key` is the name of the key's file; empty without one."""

    places: tuple[Place, ...]
    application: int
    key: str


def read_fleet(text: str) -> Fleet:
    """What of a fleet file is needed to stop it. Raises CannotStop."""
    try:
        top = yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise CannotStop(f"not YAML: {error}") from None
    top = top if isinstance(top, dict) else {}
    robots = top.get("robots")
    if not isinstance(robots, list) or not robots:
        raise CannotStop("it lists no robots")
    application, key = top.get("application_id"), top.get("key")
    return Fleet(
        tuple(_place(i, robot if isinstance(robot, dict) else {}) for i, robot in enumerate(robots)),
        application if isinstance(application, int) and 0 <= application <= 65535 else 0,
        "" if top.get("insecure") is True else key if isinstance(key, str) else "fleet.key",
    )


def _place(pid: int, robot: dict[str, Any]) -> Place:
    host, port = parse_address(str(robot.get("address", "")))
    control = robot.get("control")
    if port:
        port = control if isinstance(control, int) and 0 < control <= 65535 else control_port(port)
    return Place(str(robot.get("name", f"robot {pid}")), host, port)


def read_key(path: Path, warn: Callable[[str], None]) -> bytes:
    """The fleet's key. One that is not kept well is warned of, but is no reason not to stop. Raises CannotStop."""
    try:
        return load_key(path)
    except BadKey as error:
        with suppress(OSError):
            key = path.read_bytes()
            if len(key) == KEY_SIZE:
                warn(f"warning: {error}")
                return key
        raise CannotStop(str(error), "`--key FILE` names another; ") from None


class Stopping:
    """One robot's stop, seen from us: send `datagram` until `phase` is there; `take` what comes."""

    def __init__(self, application: int, key: bytes | None, nonce: bytes) -> None:
        self.phase = ""
        self.robot = ""
        self._application = application
        self._key = key
        self._nonce = nonce
        self._offer: Offer | None = None
        self._offered = 0.0

    def datagram(self, now: float) -> bytes:
        if self._offer is None or now - self._offered > STALE_OFFER:
            return encode(Ask(self._application, self._nonce), self._key)
        return encode(Stop(self._nonce, self._offer.challenge), self._key)

    def take(self, datagram: bytes, now: float) -> bool:
        """Whether it brings us further, so that the next `datagram` should go out at once."""
        match decode(datagram, self._key):
            case Offer(nonce) as offer if nonce == self._nonce:
                further = self._offer is None or now - self._offered > STALE_OFFER
                if further:
                    self._offer, self._offered, self.robot = offer, now, offer.robot
                return further
            case Stopped(nonce, _, phase) if nonce == self._nonce:
                self.phase = phase or "resting"
                return True
        return False


def stop_fleet(path: str, key_path: str | None, warn: Callable[[str], None]) -> list[Called]:
    """Stop the fleet of a fleet file. Raises CannotStop."""
    try:
        text = Path(path).read_bytes().decode("utf-8", "replace")
        fleet = read_fleet(text)
    except OSError as error:
        raise CannotStop(f"{path}: {error.strerror or error}") from None
    except CannotStop as error:
        raise CannotStop(f"{path}: {error}") from None
    key = None
    if key_path or fleet.key:
        beside = Path(path).parent / fleet.key
        key = read_key(Path(key_path) if key_path else beside if beside.exists() else Path(fleet.key), warn)
    return stop_all(fleet.places, fleet.application, key, PATIENCE)


def show(results: list[Called], form: str) -> str:
    """What became of each robot, for people or as one JSON document."""
    if form == "json":
        robots = [
            {
                "robot": r.place.name,
                "address": f"{r.place.host}:{r.place.port}",
                "answered": bool(r.phase),
                "phase": r.phase or None,
                "after_ms": round(r.after * 1e3, 1) if r.phase else None,
                "note": r.note,
            }
            for r in results
        ]
        return json.dumps({"robots": robots}, indent=2)
    width = max(len(r.place.name) for r in results)
    return "\n".join(f"{r.place.name:<{width}}  {_told(r)}" for r in results)


def _told(result: Called) -> str:
    if not result.phase:
        return f"{result.note.replace(NO_ANSWER, NO_ANSWER.upper())} ({result.place.host}:{result.place.port})"
    did = "is at rest" if result.phase == "rested" else "is coming to rest: it lands or brakes"
    return f"{did}, answered after {result.after * 1e3:.0f} ms" + (f"; {result.note}" if result.note else "")


def stop_all(fleet: Sequence[Place], application: int, key: bytes | None, patience: float) -> list[Called]:
    """Stop all robots at once; a name that takes long to be looked up keeps nobody else waiting."""
    results = [Called(place, "", 0.0, NO_ANSWER) for place in fleet]
    every = max(_SHORTEST, _EACH * len(fleet))
    began = time.monotonic()

    def call(index: int) -> None:
        results[index] = _stop(fleet[index], Stopping(application, key, os.urandom(NONCE)), every, began, patience)

    threads = [threading.Thread(target=call, args=(i,), daemon=True) for i in range(len(fleet))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(max(0.0, began + patience + 0.2 - time.monotonic()))
    return results


def _stop(place: Place, stopping: Stopping, every: float, began: float, patience: float) -> Called:
    if not place.port:
        return Called(place, "", 0.0, "the fleet file has no address for it")
    try:
        found = socket.getaddrinfo(place.host, place.port, type=socket.SOCK_DGRAM)[0]
    except (OSError, UnicodeError) as error:
        return Called(place, "", 0.0, f"no address: {error}")
    note = NO_ANSWER
    with socket.socket(found[0], socket.SOCK_DGRAM) as caller:
        with suppress(OSError):
            caller.connect(found[4])
        while not stopping.phase and (now := time.monotonic()) < began + patience:
            try:
                caller.send(stopping.datagram(now))
                _listen(caller, stopping, now + every)
            except TimeoutError:
                continue
            except ConnectionRefusedError:
                note = f"{NO_ANSWER}: no agent runs there"
                time.sleep(every)
            except OSError as error:
                note = f"{NO_ANSWER}: {error.strerror or error}"
                time.sleep(every)
    after = time.monotonic() - began
    if not stopping.phase:
        return Called(place, "", after, note)
    odd = f"it says that it is {stopping.robot}" if stopping.robot not in ("", place.name) else ""
    return Called(place, stopping.phase, after, odd)


def _listen(caller: socket.socket, stopping: Stopping, until: float) -> None:
    """Until something brings us further or it is time to call again."""
    while (left := until - time.monotonic()) > 0:
        caller.settimeout(left)
        if stopping.take(caller.recv(SHORT + 1), time.monotonic()):
            return
