"""Beliefs: sensors, locals, actuators and copy of the shared store that each robot had at a time.

A robot's record of a round has the changes of its copy before its event, and the event's writes. All records up to a
time, applied in order, give the values at that time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Literal

import msgspec

from koordgen.runtime.trace.schema import Header, InitRecord, OfRobot, Phase, PoseRecord, Round, TraceRecord, Values

IDLE = "no event enabled"  # reason why a robot with a current copy of the store skipped a round
Of = Literal["sensor", "local", "actuator", "shared"]
_decoder = msgspec.json.Decoder()


class Change(msgspec.Struct, frozen=True):
    """A new value of a robot. `slot`: owner (pid) of the slot of an allread variable, otherwise None."""

    of: Of
    name: str
    slot: int | None
    value: Any


@dataclass(slots=True)
class Belief:
    """Values of one robot at a time.

    `round`: present round, 0 before the first. `did`: its result as text. `copied`: last round with a current copy of
    the store. `shared` has a dict by pid for an allread variable."""

    position: tuple[float, float, float] | None = None  # the truth (m, local ENU)
    phase: str = ""
    round: int = 0
    did: str = ""
    copied: int = 0
    sensors: dict[str, Any] = field(default_factory=dict)
    locals: dict[str, Any] = field(default_factory=dict)
    actuators: dict[str, Any] = field(default_factory=dict)
    shared: dict[str, Any] = field(default_factory=dict)


class Beliefs:
    """Beliefs of all robots, by pid. Records must be applied in the order of the trace."""

    def __init__(self, header: Header) -> None:
        self._slots = {v.name for v in header.shared if v.kind == "allread"}
        self.robots = {robot.pid: Belief() for robot in header.robots}

    def apply(self, record: TraceRecord) -> list[Change]:
        """Apply a record. Return the values that it changed."""
        belief = self.robots.get(record.pid) if isinstance(record, OfRobot) else None
        if belief is None:
            return []
        match record:
            case PoseRecord(position=position):
                belief.position = position
            case Phase(phase=phase):
                belief.phase = phase
            case InitRecord():
                belief.did = "init"
                return self._apply(belief, self._changes(record, record.pid))
            case Round():
                belief.round, belief.did = record.round, _did(record)
                if record.event is not None or record.fault is not None or record.skipped == IDLE:
                    belief.copied = record.round
                return self._apply(belief, self._changes(record, record.pid))
            case _:
                pass
        return []

    def _changes(self, record: InitRecord | Round, pid: int) -> Iterator[Change]:
        if isinstance(record, Round):
            for name, raw in record.copy.items():
                value = _decoder.decode(raw)
                if name in self._slots and isinstance(value, dict):
                    yield from (Change("shared", name, int(p), each) for p, each in value.items() if p.isdigit())
                else:
                    yield Change("shared", name, None, value)
            if record.restored is not None:
                yield from _own("local", record.restored.locals)
                yield from _own("actuator", record.restored.actuators)
        yield from _own("sensor", record.sensors)
        yield from _own("local", record.locals)
        yield from _own("actuator", record.actuators)
        for name, raw in record.shared.items():
            yield Change("shared", name, pid if name in self._slots else None, _decoder.decode(raw))

    def _apply(self, belief: Belief, changes: Iterator[Change]) -> list[Change]:
        """Apply the last value of each variable. Return the changes that are new."""
        found = {(change.of, change.name, change.slot): change for change in changes}
        return [change for change in found.values() if _set(belief, change)]


def _own(of: Of, values: Values) -> Iterator[Change]:
    return (Change(of, name, None, _decoder.decode(raw)) for name, raw in values.items())


def _set(belief: Belief, change: Change) -> bool:
    """Set a value. Return whether it differs from the old one."""
    groups = {"sensor": belief.sensors, "local": belief.locals, "actuator": belief.actuators, "shared": belief.shared}
    group = groups[change.of]
    key: Any = change.name
    if change.slot is not None:
        group, key = group.setdefault(change.name, {}), change.slot
    changed = key not in group or group[key] != change.value
    group[key] = change.value
    return changed


def _did(record: Round) -> str:
    if record.fault is not None:
        return f"fault: {record.fault!s}"
    return f"skipped: {record.skipped}" if record.skipped is not None else record.event or ""
