"""The fleet's true state, round by round: what each robot has of its own, and the shared store S, from what the agents
traced. Where bodies are is the world's to say (watch.py).

S of a round is S of the one before with that round's writes: first the commits of atomic events, then the plain events
by ascending pid, as the agents themselves apply them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import msgspec

from koordgen.runtime.program.program import Calls, Port, Program, Variable
from koordgen.runtime.program.property import UNKNOWN
from koordgen.runtime.trace.schema import Init, Round, Values
from koordgen.runtime.values.points import Grid, Point

# What a planner is asked with: a goal, and obstacles as cells.
_ASKED: tuple[Any, ...] = (msgspec.json.Decoder(Point), msgspec.json.Decoder(tuple[Grid, ...]))
_by_pid = msgspec.json.Decoder(dict[str, msgspec.Raw])


@dataclass(slots=True)
class _Robot:
    """What one robot has told. `rounds` wait to be applied."""

    init: Init | None = None
    told: int = 0  # the last round that it told of
    rounds: dict[int, Round] = field(default_factory=dict)
    calls: Calls = ()  # in the round that was applied last


class Truth:
    """`values` by name: of a local variable, an actuator, a sensor and an allread variable a list by pid, of an
    allwrite variable its value; UNKNOWN where nobody has told. Sensors are as sampled at the start of `round`, the last
    one that was applied, everything else as after it; of round 0, after `init`."""

    def __init__(self, program: Program, n: int) -> None:
        self.round = -1
        self.values: dict[str, Any] = {}
        self._robots = [_Robot() for _ in range(n)]
        self._program, self._clears = program, program.clears
        self._locks = {event.name: event.lock is not None for event in program.events}
        self._slots = {v.name for v in program.shared if v.kind == "allread"}
        typed: list[Variable | Port] = [*program.locals, *program.shared, *program.ports]
        self._decoders: dict[str, Any] = {v.name: msgspec.json.Decoder(v.type) for v in typed}

    def hear(self, pid: int, record: Init | Round) -> None:
        """What an agent has traced, in its order."""
        robot = self._robots[pid]
        if isinstance(record, Init):
            robot.init = record
        else:
            robot.told = max(robot.told, record.round)
            robot.rounds[record.round] = record

    def told(self, pid: int) -> int:
        """The last round that a robot told of; -1 before its `init`."""
        robot = self._robots[pid]
        return robot.told if robot.told or robot.init is not None else -1

    def calls(self, pid: int) -> Calls:
        """The robot's calls of callable ports in `round`."""
        return self._robots[pid].calls

    def begin(self) -> None:
        """Before `init`: first values everywhere, actuators unset."""
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
        """Apply the next round's records, as far as they are here; round 0 is `init`."""
        self.round += 1
        if self.round == 0:
            for pid, robot in enumerate(self._robots):
                if robot.init is not None:
                    self._take(pid, robot.init.locals, robot.init.actuators)
                    self._write(pid, robot.init.shared)
            return
        records = [(pid, record) for pid, robot in enumerate(self._robots) for record in self._due(robot)]
        if len({pid for pid, record in records if record.round == self.round}) < len(self._robots):
            self._repair(record.copy for _, record in records)
        records.sort(key=lambda pair: (pair[1].round, not self._locks.get(pair[1].event or "", False), pair[0]))
        for pid, record in records:
            self._apply(pid, record)

    def sensed(self, pid: int, name: str, round_: int) -> Any:
        """A sensor as a robot sampled it at the start of a later round than `round`; UNKNOWN when it has not told."""
        record = self._robots[pid].rounds.get(round_)
        return UNKNOWN if record is None else self._read(name, record.sensors)

    def _due(self, robot: _Robot) -> list[Round]:
        """What came late is applied late."""
        robot.calls = ()
        return [robot.rounds.pop(round_) for round_ in sorted(robot.rounds) if round_ <= self.round]

    def _apply(self, pid: int, record: Round) -> None:
        for name in record.sensors:
            if name in self.values:
                self.values[name][pid] = self._read(name, record.sensors)
        if record.restored is not None:
            self._take(pid, record.restored.locals, record.restored.actuators)
        self._take(pid, record.locals, record.actuators)
        for name in record.actuators:
            for sensor in self._clears.get(name, ()):
                if sensor in self.values:
                    self.values[sensor][pid] = False
        self._write(pid, record.shared)
        self._robots[pid].calls = tuple(
            (port, _arguments(args), self._one(port, answer)) for port, args, answer in record.calls
        )

    def _take(self, pid: int, *groups: Values) -> None:
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
        """A robot that is gone may have written what it told nobody but the others: in their copies it is seen."""
        for copy in copies:
            for name, raw in copy.items():
                if name in self._slots:
                    for pid, own in _by_pid.decode(raw).items():
                        self.values[name][int(pid)] = self._one(name, own)
                else:
                    self.values[name] = self._one(name, raw)

    def _unset(self, name: str, init: Init | None) -> Any:
        """What an actuator has before it is written: some hold at what a sensor says."""
        port = next(p for p in self._program.ports if p.name == name)
        if port.held and init is not None:
            known = port.held in init.sensors
            return self._read(port.held, init.sensors) if known else self._read(name, init.actuators)
        return port.unset() if port.unset is not None else UNKNOWN

    def _read(self, name: str, values: Mapping[str, msgspec.Raw]) -> Any:
        return self._one(name, values[name]) if name in values else UNKNOWN

    def _one(self, name: str, raw: msgspec.Raw) -> Any:
        """A sensor's NaN and infinity are null in a trace, and not known here."""
        try:
            return self._decoders[name].decode(raw)
        except msgspec.ValidationError:
            return UNKNOWN


def _arguments(args: tuple[msgspec.Raw, ...]) -> tuple[Any, ...]:
    return tuple(decoder.decode(raw) for decoder, raw in zip(_ASKED, args, strict=False))
