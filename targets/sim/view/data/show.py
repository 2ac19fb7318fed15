"""`koordgen show`: the values that each robot of a run knew at one time, as text or JSON."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import msgspec

from koordgen.runtime.trace.schema import End, Header, TraceRecord, Violation
from targets.sim.judging.summary import place, seconds
from targets.sim.trace.beliefs import Belief, Beliefs

LONGEST = 200  # characters of a value in text
DIGITS = 4  # decimals in text
SAME = 1e-3  # seconds: a round that begins at the requested time is included


def at(header: Header, records: Iterable[TraceRecord], time: float | None) -> tuple[float, Beliefs]:
    """Return the time and the beliefs at it (s since round 1).

    Without a time: the first violation, otherwise the mission's end. Raises BadTrace."""
    beliefs, now = Beliefs(header), 0.0
    for record in records:
        if isinstance(record, Header):
            continue
        if time is None and isinstance(record, (Violation, End)):
            return record.t, beliefs
        if time is not None and record.t > time + SAME:
            break
        now = record.t
        beliefs.apply(record)
    return (now if time is None else time), beliefs


def as_json(header: Header, time: float, beliefs: Beliefs) -> str:
    """Return one JSON document; an allread variable is an object by robot."""
    robots = []
    for robot in header.robots:
        belief = beliefs.robots[robot.pid]
        own = {name: getattr(belief, name) for name in ("sensors", "locals", "actuators")}
        facts = {"position": belief.position, "phase": belief.phase, "round": belief.round, "did": belief.did}
        shared = {name: _by_robot(header, value) for name, value in belief.shared.items()}
        robots.append({"robot": robot.name, **facts, **own, "copied": belief.copied, "shared": shared})
    document = msgspec.json.encode({"app": header.app, "t": time, "robots": robots})
    return msgspec.json.format(document, indent=2).decode()


def as_text(header: Header, time: float, beliefs: Beliefs) -> str:
    """Return a block of text for each robot."""
    lines = [f"{header.app} at {seconds(time)} s since round 1"]
    for robot in header.robots:
        lines += ["", *_block(header, robot.name, beliefs.robots[robot.pid])]
    return "\n".join(lines)


def _block(header: Header, name: str, belief: Belief) -> list[str]:
    did = f", {belief.did}" if belief.did else ""
    rows = [("true position", place(belief.position))]
    for group in ("sensors", "locals", "actuators"):
        rows += [(f"{group[:-1]} {key}", _shown(value)) for key, value in getattr(belief, group).items()]
    for key, value in belief.shared.items():
        slots = _by_robot(header, value) if isinstance(value, dict) else None
        cells = {key: value} if slots is None else {f"{key}[{owner}]": each for owner, each in slots.items()}
        rows += [(f"shared {cell}", _shown(each)) for cell, each in cells.items()]
    width = max(len(label) for label, _ in rows)
    head = f"{name}: {belief.phase or 'not started'}, round {belief.round}{did}"
    old = f"  its copy of the shared variables is of round {belief.copied}" if belief.copied < belief.round else ""
    return [head, *(f"  {label:{width}}  {value}" for label, value in rows), *filter(None, [old])]


def _by_robot(header: Header, value: Any) -> Any:
    """Replace pids by robots' names in the slots of an allread variable."""
    if not isinstance(value, dict):
        return value
    return {robot.name: value[robot.pid] for robot in header.robots if robot.pid in value}


def _shown(value: Any) -> str:
    text = msgspec.json.encode(_rounded(value)).decode()
    return text if len(text) <= LONGEST else f"{text[:LONGEST]} ..."


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return round(value, DIGITS) + 0.0  # no -0.0
    if isinstance(value, Mapping):
        return {key: _rounded(each) for key, each in value.items()}
    return [_rounded(each) for each in value] if isinstance(value, list) else value
