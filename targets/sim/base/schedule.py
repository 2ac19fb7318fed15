"""Schedule of a run's faults: reads a scenario file and reports its mistakes.

`read` checks plain data for both callers: the compiler's command line, which adds lines and columns, and a bundle,
which receives JSON. Times are t, in seconds since the start of round 1."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from typing import Any, Literal, get_args

import msgspec

from koordgen.runtime.net.network import Conditions
from koordgen.runtime.trace.schema import Wind
from targets.sim.base.bodies import Vector
from targets.sim.base.fault_state import PositioningFault
from targets.sim.base.scenario import MOST_OBSTACLES

MOST_EVENTS = 1000
Path = tuple[str | int, ...]
Kind = Literal[
    "partition", "cut", "restore", "network", "crash", "restart", "freeze", "continue", "positioning", "battery", "lag",
    "wind", "obstacle",
]  # fmt: skip
KINDS: tuple[Kind, ...] = get_args(Kind)
LASTING = ("partition",)  # kinds that require `for`
MOMENTARY = ("restore", "restart", "continue", "battery", "obstacle")  # kinds without `for`
ENDS: Mapping[Kind, Kind] = {"restart": "crash", "continue": "freeze", "restore": "cut"}
NETWORKED = ("partition", "cut", "restore", "network")
PROBABILITIES = ("loss", "duplication", "reordering")
CONDITIONS = ("loss", "delay", "jitter", "duplication", "reordering")
MOST_SECONDS = 86_400.0
MOST_DELAY = 10.0  # seconds, of delay and of jitter
DURATION = 30.0  # seconds of a run without --duration
LONGER = "ask for a longer --duration, or leave it out"


class Mistake(msgspec.Struct, frozen=True):
    """A mistake in a scenario file.

    `path` leads to the wrong part (with `at_key`, to its key). `code` is from the compiler's catalogue of
    diagnostics."""

    code: str
    path: Path
    message: str
    hint: str = ""
    at_key: bool = False


class LinkConditions(msgspec.Struct, frozen=True):
    """Conditions of one direction between two robots: `given` overrides those of all links."""

    sender: str
    receiver: str
    given: dict[str, float]

    def over(self, network: Conditions) -> Conditions:
        """Return the link's conditions, given those of all links."""
        return dataclasses.replace(network, **self.given)


class Event(msgspec.Struct, frozen=True):
    """One fault, from `at` for `lasts` seconds.

    `lasts` is None for a fault until the next of its kind; a crash, a freeze or a cut lasts until the event that ENDS
    it. `robots` are those concerned. Of the other fields, only those of the kind are set: groups of a partition,
    battery level (a part of 1), lag (s), conditions of all links, number of an obstacle and the vector by which it
    moves (m, ENU)."""

    kind: Kind
    at: float
    lasts: float | None = None
    robots: tuple[str, ...] = ()
    groups: tuple[tuple[str, ...], ...] = ()
    positioning: PositioningFault = PositioningFault()
    level: float = 1.0
    lag: float = 0.0
    wind: Wind = Wind()
    network: Conditions = Conditions()
    number: int = 0
    by: Vector = (0.0, 0.0, 0.0)

    @property
    def end(self) -> float:
        """Earliest time at which another fault of the same kind may begin."""
        if self.lasts is None:
            return math.inf if self.kind in ENDS.values() else self.at
        return self.at + self.lasts


class Schedule(msgspec.Struct, frozen=True):
    """Faults of a run.

    `network` holds the conditions of all links except `links`; None if the file has none."""

    network: Conditions | None = None
    links: tuple[LinkConditions, ...] = ()
    events: tuple[Event, ...] = ()

    @property
    def networked(self) -> bool:
        """True if the schedule affects datagrams between robots."""
        return self.network is not None or bool(self.links) or any(e.kind in NETWORKED for e in self.events)


def read(data: Any, robots: Sequence[str], duration: float = math.inf) -> tuple[Schedule, list[Mistake]]:
    """Read a schedule from plain data (as of JSON).

    It is for a fleet with these names and a run of `duration` seconds.

    Returns the schedule without its wrong parts, and the mistakes."""
    form = _ScheduleParser(robots)
    top = form.table(data, (), "the scenario", (), ("network", "links", "events"))
    network = Conditions(**form.conditions(top["network"], ("network",), "network")) if "network" in top else None
    links = [form.link(entry, ("links", i)) for i, entry in enumerate(form.items(top.get("links"), ("links",)))]
    entries = form.items(top.get("events"), ("events",))
    if len(entries) > MOST_EVENTS:
        form.report("F005", ("events",), f"events lists {len(entries)}; there may be at most {MOST_EVENTS}")
    events = [form.event(entry, ("events", i)) for i, entry in enumerate(entries)]
    form.check_duplicate_links(links)
    form.check_overlaps(events)
    for i, event in enumerate(events):
        if event is not None and event.at >= duration:
            form.report("F005", ("events", i, "at"), too_late(event, duration), LONGER)
    known = sorted((e for e in events if e is not None), key=lambda e: e.at)
    return Schedule(network, tuple(link for link in links if link is not None), tuple(known)), form.mistakes


def too_late(event: Event, duration: float) -> str:
    """Return the message for an event after the run's end.

    It is refused, for it would pass as a fault survived."""
    return f"the {event.kind} at {event.at:g} s would come after the run's end, at {duration:g} s"


class _ScheduleParser:
    """Parser of plain data. A wrong part is reported once and replaced by None or a default."""

    def __init__(self, robots: Sequence[str]) -> None:
        self._robots = tuple(robots)
        self.mistakes: list[Mistake] = []

    def report(self, code: str, path: Path, message: str, hint: str = "", at_key: bool = False) -> None:
        self.mistakes.append(Mistake(code, path, message, hint, at_key))

    def table(
        self, data: Any, path: Path, what: str, required: Sequence[str], optional: Sequence[str]
    ) -> Mapping[str, Any]:
        if not isinstance(data, dict):
            self.report("F004", path, f"{what} must be a mapping (key: value)")
            return {}
        known = [*required, *optional]
        meant = set()
        for key in data:
            if key not in known:
                near = next(iter(get_close_matches(str(key), known, 1)), None)
                meant.add(near)
                hint = f"did you mean {near!r}?" if near else f"known here: {', '.join(sorted(known))}"
                self.report("F002", (*path, key), f"unknown key {key!r} in {what}", hint, at_key=True)
        for key in required:
            if key not in data and key not in meant:
                self.report("F003", path, f"{what} lacks {key!r}")
        return {key: value for key, value in data.items() if key in known}

    def items(self, data: Any, path: Path) -> Sequence[Any]:
        if data is None:
            return ()
        if not isinstance(data, list):
            self.report("F004", path, f"{path[-1]} must be a list")
            return ()
        return data

    def number(self, data: Any, path: Path, what: str, least: float, most: float) -> float | None:
        sound = (type(data) is int and abs(data) < 2**53) or (type(data) is float and math.isfinite(data))
        if not sound:
            self.report("F004", path, f"{what} must be a finite number, not {data!r:.40}")
            return None
        if not least <= data <= most:
            self.report("F005", path, f"{what} is {data:g}; it must be {least:g} to {most:g}")
            return None
        return float(data)

    def vector(self, data: Any, path: Path, what: str, most: float) -> Vector | None:
        if not isinstance(data, list) or len(data) != 3:
            self.report("F004", path, f"{what} must be [x, y, z], three numbers")
            return None
        x, y, z = (self.number(v, (*path, i), f"{what}'s {'xyz'[i]}", -most, most) for i, v in enumerate(data))
        return None if x is None or y is None or z is None else (x, y, z)

    def robot(self, data: Any, path: Path) -> str | None:
        if isinstance(data, str) and data in self._robots:
            return data
        near = next(iter(get_close_matches(str(data), self._robots, 1)), None)
        hint = f"did you mean {near!r}?" if near else f"there are: {', '.join(self._robots)}"
        self.report("F005", path, f"no robot {data!r} in this fleet", hint)
        return None

    def conditions(self, data: Any, path: Path, what: str, more: Sequence[str] = ()) -> dict[str, float]:
        """Return the conditions given in a table; `more` names other keys that the table may have."""
        found = {}
        for key, value in self.table(data, path, what, more, CONDITIONS).items():
            if key in CONDITIONS:
                share = key in PROBABILITIES
                unit = "a part of 1" if share else "seconds"
                found[key] = self.number(
                    value, (*path, key), f"{what}.{key} ({unit})", 0.0, 1.0 if share else MOST_DELAY
                )
        return {key: value for key, value in found.items() if value is not None}

    def link(self, data: Any, path: Path) -> LinkConditions | None:
        what = f"link {path[-1]}"
        given = self.conditions(data, path, what, ("from", "to"))
        if not isinstance(data, dict) or "from" not in data or "to" not in data:
            return None
        sender, receiver = self.robot(data["from"], (*path, "from")), self.robot(data["to"], (*path, "to"))
        if sender is None or receiver is None:
            return None
        if sender == receiver:
            self.report("F005", (*path, "to"), f"{what} leads from {sender} to itself")
            return None
        return LinkConditions(sender, receiver, given)

    def check_duplicate_links(self, links: Sequence[LinkConditions | None]) -> None:
        seen: dict[tuple[str, str], int] = {}
        for number, link in enumerate(links):
            if link is not None and (first := seen.setdefault((link.sender, link.receiver), number)) != number:
                told = f"link {number} is from {link.sender} to {link.receiver}, as link {first}"
                self.report("F006", ("links", number), told)

    def event(self, data: Any, path: Path) -> Event | None:
        what = f"event {path[-1]}"
        given = self.table(data, path, what, ("at",), ("for", *KINDS))
        kinds = [kind for kind in KINDS if kind in given]
        at = (
            self.number(given["at"], (*path, "at"), f"{what}.at (seconds)", 0.0, MOST_SECONDS)
            if "at" in given
            else None
        )
        lasts = None
        if "for" in given:
            lasts = self.number(given["for"], (*path, "for"), f"{what}.for (seconds)", 1e-3, MOST_SECONDS)
        if len(kinds) != 1:
            said = f"is {' and '.join(kinds)} at once" if kinds else "says nothing that happens"
            if isinstance(data, dict) and (kinds or not self._has_mistake(path)):
                self.report("F005", path, f"{what} {said}", f"an event is one of: {', '.join(KINDS)}")
            return None
        kind = kinds[0]
        if kind in LASTING and "for" not in given:
            self.report("F003", path, f"{what} lacks 'for': how many seconds the {kind} lasts")
        if kind in MOMENTARY and "for" in given:
            self.report("F005", (*path, "for"), f"a {kind} takes no time", "leave `for` out", at_key=True)
        event = self._with_details(Event(kind, at or 0.0, lasts), given[kind], (*path, kind), what)
        return None if event is None or self._has_mistake(path) else event

    def _has_mistake(self, path: Path) -> bool:
        """Return whether a mistake inside `path` was already reported."""
        return any(mistake.path[: len(path)] == path for mistake in self.mistakes)

    def _with_details(self, event: Event, data: Any, path: Path, what: str) -> Event | None:
        put = msgspec.structs.replace
        match event.kind:
            case "partition":
                return put(event, groups=self._groups(data, path, what), robots=self._robots)
            case "cut" | "restore":
                pair = self._pair(data, path, what)
                return None if pair is None else put(event, robots=pair)
            case "network":
                return put(event, network=Conditions(**self.conditions(data, path, "network")), robots=self._robots)
            case "crash" | "restart" | "freeze" | "continue":
                name = self.robot(data, path)
                return None if name is None else put(event, robots=(name,))
            case "wind":
                return put(event, wind=self._wind(data, path))
            case "obstacle":
                number, by = self._move(data, path, what)
                return None if number is None or by is None else put(event, number=number, by=by)
        required = {"positioning": (), "battery": ("level",), "lag": ("seconds",)}[event.kind]
        optional = ("noise", "bias", "delay", "dropout") if event.kind == "positioning" else ()
        keys = self.table(data, path, f"{what}.{event.kind}", ("robot", *required), optional)
        name = self.robot(keys["robot"], (*path, "robot")) if "robot" in keys else None
        match event.kind:
            case "battery":
                level = self.number(keys.get("level", 0.0), (*path, "level"), "level (a part of 1)", 0.0, 1.0)
                event = put(event, level=level or 0.0)
            case "lag":
                seconds = self.number(keys.get("seconds", 0.0), (*path, "seconds"), "seconds", 0.0, 5.0)
                event = put(event, lag=seconds or 0.0)
            case _:
                event = put(event, positioning=self._positioning(keys, path))
        return None if name is None else put(event, robots=(name,))

    def _groups(self, data: Any, path: Path, what: str) -> tuple[tuple[str, ...], ...]:
        seen: dict[str, int] = {}
        found = []
        for number, group in enumerate(self.items(data, path)):
            names = []
            for place, entry in enumerate(self.items(group, (*path, number))):
                here = (*path, number, place)
                name = self.robot(entry, here)
                if name is not None and name in seen:
                    self.report("F006", here, f"{name} is in two groups of {what}")
                elif name is not None:
                    seen[name] = number
                    names.append(name)
            found.append(tuple(names))
        if not self._has_mistake(path) and len(found) + (len(seen) < len(self._robots)) < 2:
            hint = "name at least two groups, such as [[ann, bob], [cem]]; a robot in no group is alone"
            self.report("F005", path, f"{what} parts nobody from anybody", hint)
        return tuple(found)

    def _pair(self, data: Any, path: Path, what: str) -> tuple[str, str] | None:
        """Return two different robots of this fleet, or None."""
        if not isinstance(data, list) or len(data) != 2:
            self.report("F004", path, f"{path[-1]} of {what} must be two robots, such as [ann, bob]")
            return None
        one, other = (self.robot(name, (*path, k)) for k, name in enumerate(data))
        if one is None or other is None:
            return None
        if one == other:
            self.report("F005", path, f"{what} names {one} twice")
            return None
        return one, other

    def _move(self, data: Any, path: Path, what: str) -> tuple[int | None, Vector | None]:
        keys = self.table(data, path, f"{what}.obstacle", ("number", "by"), ())
        number, by = keys.get("number", 0), self.vector(keys.get("by", [0, 0, 0]), (*path, "by"), "by (metres)", 1000.0)
        if type(number) is not int or not 0 <= number < MOST_OBSTACLES:
            self.report("F005", (*path, "number"), f"number must be that of an obstacle, from 0, not {number!r:.40}")
            return None, None
        return number, by

    def _positioning(self, keys: Mapping[str, Any], path: Path) -> PositioningFault:
        found: dict[str, Any] = {}
        if "bias" in keys:
            found["bias"] = self.vector(keys["bias"], (*path, "bias"), "bias (metres)", 1000.0)
        for key, most in (("noise", 100.0), ("delay", 60.0), ("dropout", 1.0)):
            if key in keys:
                found[key] = self.number(keys[key], (*path, key), key, 0.0, most)
        if not found and "robot" in keys:
            self.report("F003", path, "positioning says nothing that is wrong", "one of: noise, bias, delay, dropout")
        return PositioningFault(**{key: value for key, value in found.items() if value is not None})

    def _wind(self, data: Any, path: Path) -> Wind:
        keys = self.table(data, path, "wind", (), ("mean", "gust", "correlation"))
        found: dict[str, Any] = {}
        if "mean" in keys:
            found["mean"] = self.vector(keys["mean"], (*path, "mean"), "mean (m/s)", 50.0)
        for key, least, most in (("gust", 0.0, 50.0), ("correlation", 0.01, 1000.0)):
            if key in keys:
                found[key] = self.number(keys[key], (*path, key), key, least, most)
        return Wind(**{key: value for key, value in found.items() if value is not None})

    def check_overlaps(self, events: Sequence[Event | None]) -> None:
        """Report two faults of one kind at a time on one robot or pair, and crashes of a crashed robot."""
        known = [(number, event) for number, event in enumerate(events) if event is not None]
        known.sort(key=lambda pair: pair[1].at)
        busy: dict[tuple[str, str], tuple[int, Event]] = {}
        for number, event in known:
            what = ENDS.get(event.kind, event.kind)
            for name in _subjects(event):
                first = busy.get((what, name))
                if event.kind not in ENDS and first is not None and event.at < first[1].end:
                    whose = f" of {name}" if name else ""
                    self.report(
                        "F006", ("events", number, "at"),
                        f"event {number}, {event.kind}{whose} at {event.at:g} s, begins while event {first[0]} "
                        f"({_shown(first[1])}) lasts",
                        next((f"a {ending} ends a {ended}" for ending, ended in ENDS.items() if ended == what),
                             "let one end before the next begins"),
                    )  # fmt: skip
                if event.kind in ENDS:
                    busy.pop((what, name), None)
                else:
                    busy[what, name] = number, event


def _subjects(event: Event) -> tuple[str, ...]:
    """Return the objects that an event acts on. Only one event of a kind at a time may act on an object."""
    match event.kind:
        case "partition" | "wind" | "network":
            return ("",)
        case "cut" | "restore":
            return (" and ".join(sorted(event.robots)),)
        case "obstacle":
            return (f"number {event.number}",)
    return event.robots


def _shown(event: Event) -> str:
    until = f"to {event.end:g} s" if math.isfinite(event.end) else "for good"
    return f"{event.at:g} s {until}"
