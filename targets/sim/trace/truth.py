"""True state of the fleet, round by round.

Each robot's private values and the shared store S, from traces.

Positions of bodies are not included: the world has them (watch.py). S of a round is S of the round before with that
round's writes: first the commits of atomic events, then the plain events by ascending pid, as the agents apply them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import msgspec

from koordgen.runtime.program.program import Calls, Port, Program, Variable
from koordgen.runtime.program.property import UNKNOWN
from koordgen.runtime.trace.schema import InitRecord, Round, Values
from koordgen.runtime.values.points import Grid, Point

# Arguments of a planner call: a goal, and obstacles as cells.
_CALL_ARGUMENTS: tuple[Any, ...] = (msgspec.json.Decoder(Point), msgspec.json.Decoder(tuple[Grid, ...]))
_by_pid = msgspec.json.Decoder(dict[str, msgspec.Raw])


@dataclass(slots=True)
class _Robot:
    """Records of one robot. `rounds` wait to be applied."""

    init: InitRecord | None = None
    last_recorded: int = 0  # the last recorded round
    rounds: dict[int, Round] = field(default_factory=dict)
    calls: Calls = ()  # in the round applied last


class Truth:
    """Values of all variables and ports after a round.

    `values` by name: a list by pid for a local variable, an actuator, a sensor and an allread variable, one value for
    an allwrite variable; UNKNOWN without a record. Sensors are as sampled at the start of `round`, the last round
    applied; all others are as after it. Round 0 is `init`."""

    def __init__(self, program: Program, n: int) -> None:
        self.round = -1
        self.values: dict[str, Any] = {}
        self._robots = [_Robot() for _ in range(n)]
        self._program, self._clears = program, program.clears
        self._locks = {event.name: event.lock is not None for event in program.events}
        self._slots = {v.name for v in program.shared if v.kind == "allread"}
        typed: list[Variable | Port] = [*program.locals, *program.shared, *program.ports]
        self._decoders: dict[str, Any] = {v.name: msgspec.json.Decoder(v.type) for v in typed}

    def hear(self, pid: int, record: InitRecord | Round) -> None:
        """Add a record of an agent. Call in its order."""
        robot = self._robots[pid]
        if isinstance(record, InitRecord):
            robot.init = record
        else:
            robot.last_recorded = max(robot.last_recorded, record.round)
            robot.rounds[record.round] = record

    def last_recorded(self, pid: int) -> int:
        """Return the last recorded round of a robot; -1 before its `init`."""
        robot = self._robots[pid]
        return robot.last_recorded if robot.last_recorded or robot.init is not None else -1

    def calls(self, pid: int) -> Calls:
        """Return the robot's calls of callable ports in `round`."""
        return self._robots[pid].calls

    def begin(self) -> None:
        """Set the values before `init`: initial values, and actuators unset."""
        n = len(self._robots)
        inits = [robot.init for robot in self._robots]
        for variable in self._program.locals:
            self.values[variable.name] = [variable.initial() for _ in range(n)]
        for variable in self._program.shared:
            first = variable.initial()
            self.values[variable.name] = [first] * n if variable.kind == "allread" else first
        for port in self._program.ports:
            if port.direction == "sensor":
                self.values[port.name] = [self._read(port.name, init.sensors) if init else UNKNOWN for init in inits]
            elif port.direction == "actuator":
                self.values[port.name] = [self._unset(port.name, init) for init in inits]

    def advance(self) -> None:
        """Apply the available records of the next round; round 0 is `init`."""
        self.round += 1
        if self.round == 0:
            for pid, robot in enumerate(self._robots):
                if robot.init is not None:
                    self._set_values(pid, robot.init.locals, robot.init.actuators)
                    self._write(pid, robot.init.shared)
            return
        records = [(pid, record) for pid, robot in enumerate(self._robots) for record in self._due(robot)]
        if len({pid for pid, record in records if record.round == self.round}) < len(self._robots):
            self._repair(record.copy for _, record in records)
        records.sort(key=lambda pair: (pair[1].round, not self._locks.get(pair[1].event or "", False), pair[0]))
        for pid, record in records:
            self._apply(pid, record)

    def sensed(self, pid: int, name: str, round_: int) -> Any:
        """Return a sensor as sampled at the start of a round after `round`; UNKNOWN without a record."""
        record = self._robots[pid].rounds.get(round_)
        return UNKNOWN if record is None else self._read(name, record.sensors)

    def _due(self, robot: _Robot) -> list[Round]:
        """Return the records to apply now. A late record is applied late."""
        robot.calls = ()
        return [robot.rounds.pop(round_) for round_ in sorted(robot.rounds) if round_ <= self.round]

    def _apply(self, pid: int, record: Round) -> None:
        for name in record.sensors:
            if name in self.values:
                self.values[name][pid] = self._read(name, record.sensors)
        if record.restored is not None:
            self._set_values(pid, record.restored.locals, record.restored.actuators)
        self._set_values(pid, record.locals, record.actuators)
        for name in record.actuators:
            for sensor in self._clears.get(name, ()):
                if sensor in self.values:
                    self.values[sensor][pid] = False
        self._write(pid, record.shared)
        self._robots[pid].calls = tuple(
            (port, _arguments(args), self._one(port, answer)) for port, args, answer in record.calls
        )

    def _set_values(self, pid: int, *groups: Values) -> None:
        for group in groups:
            for name in group:
                self.values[name][pid] = self._read(name, group)

    def _write(self, pid: int, written: Values) -> None:
        for name in written:
            value = self._read(name, written)
            if name in self._slots:
                self.values[name][pid] = value
            else:
                self.values[name] = value

    def _repair(self, copies: Iterable[Values]) -> None:
        """Recover writes of a robot that is gone from the copies of the others."""
        for copy in copies:
            for name, raw in copy.items():
                if name in self._slots:
                    for pid, own in _by_pid.decode(raw).items():
                        self.values[name][int(pid)] = self._one(name, own)
                else:
                    self.values[name] = self._one(name, raw)

    def _unset(self, name: str, init: InitRecord | None) -> Any:
        """Return an actuator's value before it is written: some hold the value of a sensor."""
        port = next(p for p in self._program.ports if p.name == name)
        if port.held and init is not None:
            known = port.held in init.sensors
            return self._read(port.held, init.sensors) if known else self._read(name, init.actuators)
        return port.unset() if port.unset is not None else UNKNOWN

    def _read(self, name: str, values: Mapping[str, msgspec.Raw]) -> Any:
        return self._one(name, values[name]) if name in values else UNKNOWN

    def _one(self, name: str, raw: msgspec.Raw) -> Any:
        """Decode a value. A sensor's NaN and infinity are null in a trace and UNKNOWN here."""
        try:
            return self._decoders[name].decode(raw)
        except msgspec.ValidationError:
            return UNKNOWN


def _arguments(args: tuple[msgspec.Raw, ...]) -> tuple[Any, ...]:
    return tuple(decoder.decode(raw) for decoder, raw in zip(_CALL_ARGUMENTS, args, strict=False))
