"""Comparison of an outer robot's trace with that of the squad that it is.

An event of the outer robot reads sensors of a state S_k of the squad, and its commands become writes of the squad's
host. The record in the squad's store bounds k. Let w be the inner round whose writes first contain the outer event.
Then k is at most w. It is at least the round of the host's write before the one that contains the previous outer event,
and at least the k of that event. The record also has the last outer round that the outer robot has applied, which
bounds k from above in a round without an event.

A command is in the squad's store when the write of the next outer event is."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from koordgen.lang.ir.decl import Program
from koordgen.lang.ir.ports import clears, held
from koordgen.lang.semantics.exec import declared
from koordgen.runtime.program.property import UNKNOWN
from koordgen.runtime.values.points import Point
from koordgen.verify.audit.history import RobotHistory
from koordgen.verify.audit.squad_states import NO_VALUE, SquadStates
from koordgen.verify.replay.hosted import commanded
from koordgen.verify.replay.store import had_frame
from koordgen.verify.replay.trace import TraceLine
from koordgen.verify.replay.values import BadValue, from_trace, plain


class LevelDifference(NamedTuple):
    """Difference between an outer robot and its squad.

    `outer_line`, `inner_line`: lines of the two traces, 0 if there is none. `outer_round`, `inner_round`: rounds of the
    two fleets. `what`: name of the sensor or the command. `outer`, `inner`: the values. `why`: text for users."""

    outer_line: int
    outer_round: int
    inner_line: int
    inner_round: int
    what: str
    outer: Any
    inner: Any
    why: str


class _OuterEvent(NamedTuple):
    """Event of the outer robot, its `init` (round 0), a round in which it only read its sensors, or a new start of its
    agent, which restores its actuators.

    `commands`: last command of each actuator up to this event, clamped to the geofence. `own`: those of this event.
    `written`: inner round whose writes first contain the event; None without an event, or if no record of the squad
    shows it."""

    round: int
    line: int
    sensors: Mapping[str, Any]
    own: Mapping[str, Any]
    commands: Mapping[str, Any]
    written: int | None
    is_start: bool


@dataclass
class SquadComparison:
    """Comparison of one outer robot with its squad.

    `program`: the outer program. `history`: of the outer robot, in the mission with the id `mission`. `geofence`: lower
    and upper corner of the outer fleet's geofence, or None.
    `readings`: number of rounds whose sensors are those of the squad. `unchecked`: number of comparisons for which a
    trace lacks values."""

    program: Program
    history: RobotHistory
    mission: str
    states: SquadStates
    geofence: Sequence[Sequence[float]] | None
    readings: int = 0
    unchecked: int = 0

    def __post_init__(self) -> None:
        self._confirmed: set[tuple[str, int]] = set()  # (actuator, outer round) of the commands in the squad's store
        self._types = declared(self.program)
        self._variables = {port: name for port, name in commanded(self.states.program).items() if port in self._types}
        self._clearable = {sensor for cleared in clears(self.program).values() for sensor in cleared}
        self._held = held(self.program)
        self._events = list(self._found_events())

    def differences(self) -> list[LevelDifference]:
        """Return all differences, first those of sensors, then those of commands."""
        return [*self._sensor_differences(), *self._write_differences(), *self._command_differences()]

    @property
    def commands(self) -> int:
        """Number of commands that are in the squad's store."""
        return len(self._confirmed)

    # Outer events and the inner rounds that record them.

    def _found_events(self) -> Iterator[_OuterEvent]:
        first_writes = self.states.first_writes(self.mission)
        commands: dict[str, Any] = {}
        at = self.states.first
        for round_, line in self._lines():
            record = line.record
            restored = record.get("restored")
            if restored is not None:
                own = self._clamped(restored.get("actuators", {}))
                commands = commands | own
                yield _OuterEvent(round_, line.number, {}, own, commands, None, True)
            if round_ and (record.get("event") is None or record.get("fault")):
                if had_frame(record):
                    yield _OuterEvent(round_, line.number, record.get("sensors", {}), {}, commands, None, False)
                continue
            own = self._clamped(record.get("actuators", {}))
            commands = commands | own
            written = first_writes.get(round_)
            written = None if written is None or written < at else written
            at = at if written is None else written
            yield _OuterEvent(round_, line.number, record.get("sensors", {}), own, commands, written, not round_)

    def _lines(self) -> list[tuple[int, TraceLine]]:
        """Return `init` and the rounds of the outer robot in their order."""
        inits = [line for life in self.history.lives for line in life.lines if line.record["kind"] == "init"]
        return [*((0, line) for line in inits[-1:]), *sorted(self.history.rounds.items())]

    def _before(self, written: int) -> int:
        """Return a round that is not later than that of the host's write before the one of round `written`."""
        round_ = written
        while round_ > self.states.first and self.states.has_same_record(round_ - 1, written):
            round_ -= 1
        return max(self.states.first, round_ - 1)

    def _clamped(self, actuators: Mapping[str, Any]) -> dict[str, Any]:
        found = {}
        for name, value in actuators.items():
            if name in self._variables:
                try:
                    found[name] = plain(self._into(from_trace(value, self._types[name])))
                except BadValue:
                    found[name] = value
        return found

    def _into(self, value: Any) -> Any:
        """Return a value with each Point in it clamped to the geofence, as the vehicle interface does."""
        if self.geofence is None:
            return value
        if isinstance(value, Point):
            corners = [sorted(pair) for pair in zip(*self.geofence, strict=True)]
            places = zip(corners, (value.x, value.y, value.z), strict=True)
            return Point(*(max(low, min(each, high)) for (low, high), each in places))
        return tuple(map(self._into, value)) if type(value) is tuple else value

    # Sensors.

    def _sensor_differences(self) -> Iterator[LevelDifference]:
        least, can_be_unset = self.states.first, True
        for event, until in zip(self._events, self._bounds(), strict=True):
            can_be_unset = can_be_unset or event.is_start
            rounds = range(min(least, until), until + 1)
            found = next((k for k in rounds if self._read(event, k, can_be_unset)), None)
            if found is None:
                if self._is_doubtful(rounds, event.sensors, is_event=event.written is not None):
                    self.unchecked += 1
                else:
                    yield from self._misread(event, rounds, can_be_unset)
            elif event.sensors:
                self.readings += 1
                least = max(least, found)
            if event.written is not None:
                least = max(least, self._before(event.written))
            if event.own and not event.is_start:
                can_be_unset = False

    def _bounds(self) -> list[int]:
        """Return for each event the last k of which it can have read S_k."""
        applied = self.states.applied(self.mission)
        until, found = self.states.last, list[int]()
        for event in reversed(self._events):
            after = bisect_left(applied, (event.round, 0))
            bounds = [event.written] if event.written is not None else [each for _, each in applied[after : after + 1]]
            until = min([until, *bounds])
            found.append(until)
        return found[::-1]

    def _read(self, event: _OuterEvent, k: int, can_be_unset: bool) -> bool:
        """Return whether the sensors of an outer event are those of the state S_k."""
        return all(self._fits(name, read, k, can_be_unset) for name, read in event.sensors.items())

    def _fits(self, name: str, read: Any, k: int, can_be_unset: bool) -> bool:
        """Return whether the outer robot could read this value of a sensor in the state S_k.

        A sensor that commands clear is true before the first command, and false until a command is carried out."""
        had = self.states.sensor(k, name)
        if name in self._clearable and (read is False or can_be_unset):
            return had is not UNKNOWN
        return isinstance(read, bool) is isinstance(had, bool) and bool(read == had)

    def _misread(self, event: _OuterEvent, rounds: range, can_be_unset: bool) -> Iterator[LevelDifference]:
        """Yield the sensors whose values no state had; all, if no state had all values at once."""
        bad = [
            name
            for name, read in event.sensors.items()
            if not any(self._fits(name, read, k, can_be_unset) for k in rounds)
        ]
        last, lacks = rounds[-1], "this value" if bad else "all sensors' values at once"
        for name in bad or event.sensors:
            had = self.states.sensor(last, name)
            yield LevelDifference(
                event.line, event.round, self.states.line(last), last, name, event.sensors[name],
                None if had is NO_VALUE else had, f"the squad did not have {lacks} in its rounds {rounds[0]} to {last}",
            )  # fmt: skip

    # Commands.

    def _write_differences(self) -> Iterator[LevelDifference]:
        """Yield the writes of the hosts that are no command of the outer robot, nor a value by which it holds."""
        known = [i for i, event in enumerate(self._events) if event.written is not None]
        rounds = [self._events[i].written or 0 for i in known]
        for write in self.states.writes:
            count = bisect_left(rounds, write.round)  # number of known events whose record was written before
            after = known[count] if count < len(known) else len(self._events)
            possible = self._events[max(0, known[count - 1] - 1) if count else 0 : max(after, 1)]
            since = rounds[count - 3] if count > 2 else self.states.first
            for port, variable in self._variables.items():
                value = write.line.record.get("shared", {}).get(variable, UNKNOWN)
                if value is UNKNOWN or value in [event.commands.get(port) for event in possible]:
                    continue
                within = range(since, write.round + 1)
                if self._holds(port, value, within):
                    continue
                if not possible or self._is_doubtful(within, [self._held.get(port, "")]):
                    self.unchecked += 1
                else:
                    why = f"{write.robot}, the host, wrote it to {variable}, which is no command of the outer robot"
                    yield LevelDifference(
                        possible[-1].line, possible[-1].round, write.line.number, write.round, port,
                        possible[-1].commands.get(port), value, why,
                    )  # fmt: skip

    def _command_differences(self) -> Iterator[LevelDifference]:
        """Yield the commands that are not in the squad's store when the record of the next outer event is.

        Commands before a new start of the outer agent and variables that inner programs write are left out."""
        due: dict[str, _OuterEvent] = {}  # actuator -> event with its last command
        since = self.states.first
        for event in self._events:
            if event.is_start:
                due = {}
            elif event.written is not None:
                rounds = range(since, event.written + 1)
                for port, commanding in due.items():
                    yield from self._uncommanded(port, commanding, event.written, rounds)
                since = max(since, self._before(self._before(event.written)))
            due |= {} if event.is_start else dict.fromkeys(event.own, event)

    def _uncommanded(
        self, port: str, commanding: _OuterEvent, written: int, rounds: range
    ) -> Iterator[LevelDifference]:
        variable, value = self._variables[port], commanding.own[port]
        had = self.states.variable(written + 1, variable)
        if variable in self.states.written_inside:
            return
        if had == value:
            self._confirmed.add((port, commanding.round))
            return
        # The robot may hold by a sensor's value, and is not commanded anew if it holds by the command's value.
        if had is not UNKNOWN and (self._holds(port, had, rounds) or self._holds(port, value, rounds)):
            return
        if had is UNKNOWN or self._is_doubtful(rounds, [self._held.get(port, "")]):
            self.unchecked += 1
        else:
            why = f"the command is not in {variable} once the next outer event is recorded"
            yield LevelDifference(
                commanding.line, commanding.round, self.states.line(written), written, port, value, had, why
            )

    def _holds(self, port: str, value: Any, rounds: range) -> bool:
        """Return whether the outer robot holds by this value of a sensor in one of the rounds."""
        sensor = self._held.get(port)
        values = [] if sensor is None else [self.states.sensor(k, sensor) for k in rounds]
        return any(each is not UNKNOWN and each == value for each in values)

    def _is_doubtful(self, rounds: range, sensors: Iterable[str], is_event: bool = True) -> bool:
        """Return whether the outer robot may have read these sensors in a state that no trace has.

        `is_event`: the state led to an event that the squad has recorded, so a host that died did not discard it."""
        is_unknown = any(self.states.sensor(k, name) is UNKNOWN for k in rounds for name in sensors)
        return is_unknown or self.states.has_rejoined_host(rounds) or not (is_event or self.states.has_one_host(rounds))
