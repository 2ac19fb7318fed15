"""Emergency stop from outside: stop all robots of a fleet at once, and report each robot's answer.

The robots of a squad, a robot that is a fleet itself, are called one by one, each with the key and the application_id
of its own fleet file.

Each robot gets stop requests every few milliseconds until it answers or the time is up. A damaged fleet file must not
prevent the stop. Addresses are therefore taken from the part of the file that can be read, from the folders of the last
build, and from the command line.
"""

from __future__ import annotations

import json
import os
import re
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import yaml

from koordgen.fleet.address import control_port, parse_address
from koordgen.lang.node import Node, replace
from koordgen.runtime.net.seal import KEY_SIZE, BadKey, load_key
from koordgen.runtime.ops.orders import NONCE, SHORT, Ask, Offer, StopAnswer, StopOrder, decode, encode

BY_HAND = "stop these robots by hand now: by remote control, by kill switch, or by cutting their power"
NO_ANSWER = "no answer"
ANSWER_TIMEOUT = 3.0  # seconds for which all robots are called before those without an answer are reported

# Seconds without an answer to the stop before a new challenge is requested, because the agent may have restarted.
STALE_OFFER = 0.3

# Period in seconds between two stop requests to one robot: _EACH times the number of robots, but at least _SHORTEST.
_SHORTEST, _EACH = 0.01, 0.0005


class Place(Node):
    """Address of a robot's control port. Port 0: the fleet file has no address for the robot.

    inner: for a squad, its robots, which have the addresses; None for an ordinary robot.
    """

    name: str
    host: str
    port: int
    inner: StoppableFleet | None = None


class Called(Node):
    """Result of the stop request to one robot.

    place: address that was called.
    phase: phase that the agent reported; empty without an answer.
    after: seconds from the first call to the answer.
    note: reason why there was no answer, or what is wrong with the answer.
    """

    place: Place
    phase: str
    after: float
    note: str


class CannotStop(Exception):
    """Raised if no robot was called, because the fleet file or the key cannot be used."""

    def __init__(self, message: str, help: str = "") -> None:
        super().__init__(message)
        self.help = help


class BadAddress(CannotStop):
    """Raised if an address from the command line is not HOST:PORT."""


class StoppableFleet(Node):
    """Robots to be stopped, and the data that authenticate the stop.

    places: control ports of the robots, in the order of the fleet file.
    application: application_id of the fleet file.
    key: name of the key file; empty for a fleet without a key.
    folder: folder in which the key file is searched first.
    """

    places: tuple[Place, ...]
    application: int
    key: str
    folder: Path = Path()


class Contact(Node):
    """Control port of one physical robot, and the data that authenticate orders to it.

    place: its name is SQUAD.ROBOT for a robot of a squad.
    robot: name of the robot in its own fleet.
    application, key: application_id and key of its own fleet; no key for a fleet without one.
    trouble: reason why the robot cannot be called; empty if it can.
    """

    place: Place
    robot: str
    application: int
    key: bytes | None
    trouble: str = ""


# Finds the robots of a squad, by its name and its fleet file as the outer fleet file spells it.
FindInner = Callable[[str, str], "StoppableFleet | None"]


def find_fleet(path: Path, warn: Callable[[str], None]) -> StoppableFleet:
    """Return the robots of a fleet file, or of a folder that `build` wrote. Raises CannotStop.

    If the fleet file cannot be parsed, all addresses in its text and all robots of the last build are returned. The
    same holds for the fleet file of a squad; a squad of which no robot is found causes a warning.
    """
    if path.is_dir():
        return _built(path, CannotStop(f"{path}: this folder contains no robot's folder with a settings.json"))

    def inner(squad: str, file: str) -> StoppableFleet:
        place = path.parent / file
        try:
            return _find_file(place, warn, _no_inner, squad)
        except CannotStop as error:
            warn(f"warning: {squad}: {error}; none of its robots is called")
            return StoppableFleet((), 0, "", place.parent)

    return _find_file(path, warn, inner, "")


def _no_inner(squad: str, file: str) -> StoppableFleet | None:
    """Find no robots: a fleet within a squad's fleet is not supported."""
    return None


def _find_file(path: Path, warn: Callable[[str], None], inner: FindInner, squad: str) -> StoppableFleet:
    """Return the robots of a fleet file; see find_fleet. `squad`: the robot of which it is the fleet, or ""."""
    text = ""
    try:
        text = path.read_bytes().decode("utf-8", "replace")
        fleet = read_fleet(text, inner)
        return StoppableFleet(fleet.places, fleet.application, fleet.key, path.parent)
    except OSError as error:
        trouble = CannotStop(f"{path}: {error.strerror or error}")
    except CannotStop as error:
        trouble = CannotStop(f"{path}: {error}")
    scanned = scan_fleet(text, inner)
    built = _last_build(path.parent, squad)
    if built is None and not scanned.places:
        raise trouble
    known = {_identity(place) for place in scanned.places}
    more = tuple([place for place in built[1].places if _identity(place) not in known]) if built else ()
    sources = ["the addresses in its text"] if scanned.places else []
    sources += [f"those of the last build, {built[0]}"] if built and more else []
    warn(f"warning: {trouble}; calling {' and '.join(sources)}")
    if scanned.places or built is None:
        return StoppableFleet((*scanned.places, *more), scanned.application, scanned.key, path.parent)
    return StoppableFleet(more, built[1].application, built[1].key, path.parent)


def _identity(place: Place) -> tuple[str, int]:
    """Return the address of a robot; the name of a squad."""
    return (place.host, place.port) if place.inner is None else (place.name, 0)


def read_fleet(text: str, inner: FindInner = _no_inner) -> StoppableFleet:
    """Return the entries of a fleet file that are needed to stop its robots. Raises CannotStop."""
    try:
        top = yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise CannotStop(f"the file is not YAML: {' '.join(str(error).split())}") from None
    top = top if isinstance(top, dict) else {}
    robots = top.get("robots")
    if not isinstance(robots, list) or not robots:
        raise CannotStop("the fleet file lists no robots")
    application, key = top.get("application_id"), top.get("key")
    return StoppableFleet(
        tuple([_place(i, robot if isinstance(robot, dict) else {}, inner) for i, robot in enumerate(robots)]),
        application if isinstance(application, int) and 0 <= application <= 65535 else 0,
        "" if top.get("insecure") is True else key if isinstance(key, str) else "fleet.key",
    )


# Patterns for a damaged fleet file. A robot's entry may begin at a dash or at a brace; comments are removed first.
_COMMENT = re.compile(r"(?m)(^|\s)#.*$")
_ENTRY = re.compile(r"(?m)^\s*-\s|\{(?=[^{}]*\b(?:address|inner)\b)")
_VALUE = r"\b{}\s*:\s*['\"]?([^\s,'\"{{}}]+)"


def scan_fleet(text: str, inner: FindInner = _no_inner) -> StoppableFleet:
    """Return the robots whose addresses, or fleet files, occur in a text that need not be valid YAML.

    The result is like that of `read_fleet`, but its `places` are empty if the text contains no address.
    """
    text = _COMMENT.sub("", text)
    places: list[Place] = []
    for part in _ENTRY.split(text):
        entry = {key: value for key in ("name", "address", "control", "inner") for value in _values(part, key)}
        control = entry.get("control", "")
        place = _place(len(places), {**entry, "control": int(control) if control.isdecimal() else None}, inner)
        if place.port or place.inner is not None:
            places.append(place)
    application = next(_values(text, "application_id"), "0")
    insecure = next(_values(text, "insecure"), "") == "true"
    return StoppableFleet(
        tuple(places),
        int(application) if application.isdecimal() and int(application) <= 65535 else 0,
        "" if insecure else next(_values(text, "key"), "fleet.key"),
    )


def _values(text: str, key: str) -> Iterator[str]:
    return (found[1] for found in re.finditer(_VALUE.format(key), text))


def _last_build(folder: Path, squad: str) -> tuple[Path, StoppableFleet] | None:
    """Return the latest build in `build/`, beside the fleet file or in the working directory.

    squad: only a build with the robots of this squad is returned, and of it only these robots; "" for all robots.
    Returns None if there is no build.
    """
    built = [each for place in {folder / "build", Path("build")} for each in _folders(place)]
    for application in sorted(built, key=lambda each: each.stat().st_mtime, reverse=True):
        with suppress(CannotStop):
            found = _built(application, CannotStop(""))
            if not squad:
                return application, found
            for place in found.places:
                if place.name == squad and place.inner is not None:
                    return application, place.inner
    return None


def _folders(place: Path) -> list[Path]:
    with suppress(OSError):
        return [each for each in place.iterdir() if each.is_dir()]
    return []


def _built(folder: Path, nobody: CannotStop) -> StoppableFleet:
    """Return the robots of a build folder, or the one robot of a robot's folder.

    Raises `nobody` if there is no robot.
    """
    levels: dict[str, StoppableFleet] = {"": StoppableFleet((), 0, "", folder)}
    harness = [agent for each in _folders(folder) for agent in _folders(each / "agents")]
    for each in sorted([folder, *_folders(folder), *_folders(folder / "robots"), *harness]):
        with suppress(OSError, ValueError, TypeError, KeyError, IndexError):
            settings = json.loads((each / "settings.json").read_bytes())
            peer = settings["peers"][settings["pid"]]
            place = Place(str(settings["robot"]), str(peer["host"]), int(settings["control"]))
            # the bundle of a squad's robot is called SQUAD.ROBOT
            squad = each.resolve().name.removesuffix(place.name).rstrip(".") if (each / "outer.json").exists() else ""
            if squad and squad not in levels:
                levels[""] = replace(levels[""], places=(*levels[""].places, Place(squad, "", 0)))
            places = levels[squad].places if squad in levels else ()
            key = "" if settings["insecure"] is True else str(settings["key_file"])
            levels[squad] = StoppableFleet((*places, place), int(settings["application_id"]), key, folder)
    if not levels[""].places:
        raise nobody
    outer = [replace(p, inner=levels.get(p.name)) if p.port == 0 else p for p in levels[""].places]
    return replace(levels[""], places=tuple(outer))


def _place(pid: int, robot: dict[str, Any], inner: FindInner = _no_inner) -> Place:
    name = str(robot.get("name", f"robot {pid}"))
    if isinstance(file := robot.get("inner"), str):
        return Place(name, "", 0, inner(name, file))
    host, port = parse_address(str(robot.get("address", "")))
    control = robot.get("control")
    if port:
        port = control if isinstance(control, int) and 0 < control <= 65535 else control_port(port)
    return Place(name, host, port)


def contacts_of(
    fleet: StoppableFleet, path: str | None, key_path: str | None, warn: Callable[[str], None]
) -> tuple[Contact, ...]:
    """Return all physical robots of a fleet, with the keys of their fleets: its own robots, and those of its squads.

    path: the fleet file. key_path: key file in place of that of the fleet file; squads use it only if the key file
    that their own fleet file names does not exist.
    Raises CannotStop if no key can be read. If only some can be read, the other robots get a `trouble`.
    """
    squads = {place.name: place.inner for place in fleet.places if place.inner is not None}
    own = [place for place in fleet.places if place.inner is None]
    levels = {"": replace(fleet, places=tuple(own))} if own or not squads else {}
    keys: dict[str, bytes | None] = {}
    failed: dict[str, CannotStop] = {}
    for squad, level in {**levels, **squads}.items():
        try:
            keys[squad] = _find_key(level, path, key_path, squad != "", warn)
        except CannotStop as error:
            failed[squad] = error
    if failed and not keys:
        raise next(iter(failed.values()))
    for squad, why in failed.items():
        warn(f"warning: {why}; {f'the robots of {squad}' if squad else 'robots that are no squads'} are not called")

    def contact(place: Place, level: StoppableFleet, squad: str) -> Contact:
        named = replace(place, name=f"{squad}.{place.name}") if squad else place
        trouble = f"no key: {failed[squad]}" if squad in failed else ""
        return Contact(named, place.name, level.application, keys.get(squad), trouble)

    found: list[Contact] = []
    for place in fleet.places:
        if place.inner is None:
            found.append(contact(place, fleet, ""))
        elif place.inner.places:
            found += [contact(each, place.inner, place.name) for each in place.inner.places]
        else:
            found.append(Contact(place, place.name, 0, None, "the robots of its fleet are not known"))
    return tuple(found)


def _find_key(
    fleet: StoppableFleet, path: str | None, key_path: str | None, is_squad: bool, warn: Callable[[str], None]
) -> bytes | None:
    """Return the fleet's key; None for a fleet without a key. Raises CannotStop.

    The key is read from `key_path`, else from the fleet's folder, else from the folder of the fleet file `path`, else
    from the working directory. For a squad, `key_path` comes last.
    """
    if not fleet.key and (is_squad or not key_path):
        return None
    beside = [folder / fleet.key for folder in (fleet.folder, Path(path).parent if path else Path(), Path())]
    there = next((place for place in beside if place.exists()), None)
    if there is not None and (is_squad or not key_path):
        return read_key(there, warn)
    return read_key(Path(key_path or fleet.key), warn)


def read_key(path: Path, warn: Callable[[str], None]) -> bytes:
    """Return the key in a file. Raises CannotStop.

    A key file that other users can read causes a warning only, because an emergency stop must not fail for it.
    """
    try:
        return load_key(path)
    except BadKey as error:
        with suppress(OSError):
            key = path.read_bytes()
            if len(key) == KEY_SIZE:
                warn(f"warning: {error}")
                return key
        raise CannotStop(str(error), "name another key file with `--key FILE`; ") from None


class Stopping:
    """Protocol that stops one robot: send `datagram`, and pass answers to `receive`, until `phase` is set."""

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
        return encode(StopOrder(self._nonce, self._offer.challenge), self._key)

    def receive(self, datagram: bytes, now: float) -> bool:
        """Return whether the answer makes progress, so that the next `datagram` should be sent at once."""
        match decode(datagram, self._key):
            case Offer(nonce) as offer if nonce == self._nonce:
                further = self._offer is None or now - self._offered > STALE_OFFER
                if further:
                    self._offer, self._offered, self.robot = offer, now, offer.robot
                return further
            case StopAnswer(nonce, _, phase) if nonce == self._nonce:
                self.phase = phase or "stopping"
                return True
        return False


def stop_fleet(
    path: str | None, key_path: str | None, warn: Callable[[str], None], by_hand: Sequence[str] = (),
    application: int | None = None,
) -> list[Called]:  # fmt: skip
    """Stop the robots of a fleet file and those at addresses that the user gave. Raises CannotStop.

    path: fleet file, or a folder that `build` wrote. `path` or `by_hand` must be given.
    by_hand: addresses HOST:PORT, as in the fleet file.
    application: overrides the application_id of the fleet file, but not that of squads.
    """
    places = tuple([_place(0, {"name": address, "address": address}) for address in by_hand])
    if wrong := [place.name for place in places if not place.port]:
        raise BadAddress(f"--address {wrong[0]}: not HOST:PORT")
    fleet = StoppableFleet((), 0, "fleet.key")
    if path is not None:
        try:
            fleet = find_fleet(Path(path), warn)
        except CannotStop as error:
            if not places:
                raise
            warn(f"warning: {error}; only the robots at the addresses of --address are called")
    inner = {(each.host, each.port) for place in fleet.places if place.inner for each in place.inner.places}
    places = tuple([place for place in places if (place.host, place.port) not in inner])
    known = {(place.host, place.port) for place in places}
    places += tuple([place for place in fleet.places if place.inner or (place.host, place.port) not in known])
    contacts = contacts_of(replace(fleet, places=places), path, key_path, warn)
    if application is not None:
        own = {place.name for place in places}
        contacts = tuple([replace(c, application=application) if c.place.name in own else c for c in contacts])
    return stop_all(contacts, ANSWER_TIMEOUT)


def show(results: list[Called], form: str) -> str:
    """Return the result of each robot's stop, as text or as one JSON document."""
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
    return "\n".join(f"{r.place.name:<{width}}  {_result_text(r)}" for r in results)


def _result_text(result: Called) -> str:
    if not result.phase:
        return f"{result.note.replace(NO_ANSWER, NO_ANSWER.upper())} ({result.place.host}:{result.place.port})"
    did = "has stopped" if result.phase == "stopped" else "is stopping: it lands or brakes"
    return f"{did}, answered after {result.after * 1e3:.0f} ms" + (f"; {result.note}" if result.note else "")


def stop_all(fleet: Sequence[Contact], timeout: float) -> list[Called]:
    """Stop all robots in parallel, one thread each, so that a slow name lookup delays no other robot."""
    results = [Called(contact.place, "", 0.0, NO_ANSWER) for contact in fleet]
    every = max(_SHORTEST, _EACH * len(fleet))
    began = time.monotonic()

    def call(index: int) -> None:
        called = fleet[index]
        stopping = Stopping(called.application, called.key, os.urandom(NONCE))
        results[index] = _stop(called, stopping, every, began, timeout)

    threads = [threading.Thread(target=call, args=(i,), daemon=True) for i in range(len(fleet))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(max(0.0, began + timeout + 0.2 - time.monotonic()))
    return results


def _stop(called: Contact, stopping: Stopping, every: float, began: float, timeout: float) -> Called:
    place = called.place
    if called.trouble:
        return Called(place, "", 0.0, f"{NO_ANSWER}: {called.trouble}")
    if not place.port:
        return Called(place, "", 0.0, "the fleet file has no address for the robot")
    try:
        found = socket.getaddrinfo(place.host, place.port, type=socket.SOCK_DGRAM)[0]
    except (OSError, UnicodeError) as error:
        return Called(place, "", 0.0, f"no address: {error}")
    note = NO_ANSWER
    with socket.socket(found[0], socket.SOCK_DGRAM) as caller:
        with suppress(OSError):
            caller.connect(found[4])
        while not stopping.phase and (now := time.monotonic()) < began + timeout:
            try:
                caller.send(stopping.datagram(now))
                _listen(caller, stopping, now + every)
            except TimeoutError:
                continue
            except ConnectionRefusedError:
                note = f"{NO_ANSWER}: no agent runs at this address"
                time.sleep(every)
            except OSError as error:
                note = f"{NO_ANSWER}: {error.strerror or error}"
                time.sleep(every)
    after = time.monotonic() - began
    if not stopping.phase:
        return Called(place, "", after, note)
    odd = f"it says that it is {stopping.robot}" if stopping.robot not in ("", called.robot) else ""
    return Called(place, stopping.phase, after, odd)


def _listen(caller: socket.socket, stopping: Stopping, until: float) -> None:
    """Receive answers until an answer makes progress or the next request is due."""
    while (left := until - time.monotonic()) > 0:
        caller.settimeout(left)
        if stopping.receive(caller.recv(SHORT + 1), time.monotonic()):
            return
