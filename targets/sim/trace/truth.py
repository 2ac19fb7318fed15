"""True state of the fleet, round by round.

Each robot's private values and the shared store S, from traces.

Positions of bodies are not included: the world has them (watch.py). S of a round is S of the round before with that
round's writes: first the commits of atomic events, then the plain events by ascending number of the instance, as the
agents apply them."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, get_args

import msgspec

from koordgen.runtime.program.fleet_program import FleetProgram
from koordgen.runtime.program.program import Calls, Port, Variable
from koordgen.runtime.program.property import UNKNOWN
from koordgen.runtime.trace.schema import InitRecord, Round, Values
from koordgen.runtime.values.points import Grid, Point

# Arguments of a planner call: a goal, and obstacles as cells.
_CALL_ARGUMENTS: tuple[Any, ...] = (msgspec.json.Decoder(Point), msgspec.json.Decoder(tuple[Grid, ...]))
_by_pid = msgspec.json.Decoder(dict[str, msgspec.Raw])
_by_index = msgspec.json.Decoder(list[msgspec.Raw])


class SharedWrite(NamedTuple):
    """Write of a shared variable in a round: its values before and after it. `instance`: number of the writer."""

    variable: str
    before: Any
    after: Any
    instance: int
    event: str


@dataclass(slots=True)
class _Instance:
    """Records of one application on one robot. `rounds` wait to be applied."""

    application: int
    pid: int  # in the application
    robot: int
    init: InitRecord | None = None
    last_recorded: int = 0  # the last recorded round
    stopped: bool = False  # it takes no more steps after its recorded rounds
    rounds: dict[int, Round] = field(default_factory=dict)
    calls: Calls = ()  # in the round applied last


class Truth:
    """Values of all variables and ports of one application after a round.

    `values` by name: a list by pid for a local variable, an actuator, a sensor and an allread variable, one value for
    an allwrite variable; UNKNOWN without a record. Sensors are as sampled at the start of `round`, the last round
    applied; all others are as after it. Round 0 is `init`.

    Names and pids are those of the application. Records of other applications count as far as they write variables
    that this application reads, too. An imported allread variable is one value: a tuple by the exporter's pids.

    `changes`: the writes of `round` to the shared variables in `traced`, in the order of their effects.
    `lacking`: instances that have not stopped and have no record of `round`, and those with an older record that was
    applied in it."""

    def __init__(self, fleet: FleetProgram, application: int = 0, traced: Collection[str] = ()) -> None:
        self.round = -1
        self.values: dict[str, Any] = {}
        self.changes: list[SharedWrite] = []
        self.lacking: set[int] = set()
        self._traced = frozenset(traced)
        self._fleet, self._number = fleet, application
        self._instances = [_Instance(i.application, i.pid, i.robot) for i in fleet.instances]
        self._by_place = {(fleet.applications[i.application].name, i.robot): i.number for i in fleet.instances}
        own = fleet.applications[application]
        self._own = [self._instances[self._by_place[own.name, robot]] for robot in own.members]
        self._program, self._members = own.program, own.members
        self._clears = [each.program.clears for each in fleet.applications]
        self._locks = [{e.name: e.lock is not None for e in each.program.events} for each in fleet.applications]
        self._views = _names_in(fleet, application)
        imported = {name for each in own.imports for name in each.variables}
        self._slots = {v.name for v in own.program.shared if v.kind == "allread"}
        self._lists = {name for name in imported if fleet.members_of(fleet.stored(application, name))}
        typed: list[Variable | Port] = [*own.program.locals, *own.program.shared, *own.program.ports]
        types = {v.name: get_args(v.type)[0] if v.name in self._lists else v.type for v in typed}
        self._decoders: dict[str, Any] = {name: msgspec.json.Decoder(type_) for name, type_ in types.items()}

    def hear(self, robot: int, record: InitRecord | Round) -> None:
        """Add a record of a robot's agent. Call in its order."""
        instance = self._instances[self.number(robot, record)]
        if isinstance(record, InitRecord):
            instance.init = record
        else:
            instance.last_recorded = max(instance.last_recorded, record.round)
            instance.rounds[record.round] = record
        instance.stopped = instance.stopped or record.stopped

    def number(self, robot: int, record: InitRecord | Round) -> int:
        """Return the number of the instance that a robot's record is about."""
        return self._by_place[record.application, robot] if self._fleet.is_composed else robot

    def last_recorded(self, robot: int) -> int:
        """Return the last round of which all instances of a robot have records; -1 before their `init`."""
        instances = [self._instances[each.number] for each in self._fleet.of_robot(robot)]
        return min([i.last_recorded if i.last_recorded or i.init is not None else -1 for i in instances])

    def calls(self, pid: int) -> Calls:
        """Return the robot's calls of callable ports in `round`."""
        return self._own[pid].calls

    def begin(self) -> None:
        """Set the values before `init`: initial values, and actuators unset."""
        n = len(self._own)
        inits = [instance.init for instance in self._own]
        for variable in self._program.locals:
            self.values[variable.name] = [variable.initial() for _ in range(n)]
        for place, robot in enumerate(self._members):
            instance = next(i for i in self._fleet.of_robot(robot) if i.application == self._number)
            for name, value in self._fleet.constants(instance).items():
                self.values.setdefault(name, [-1] * n)[place] = value
        for variable in self._program.shared:
            first = variable.initial()
            self.values[variable.name] = [first] * n if variable.kind == "allread" else first
        self._import_first_values()
        for port in self._program.ports:
            if port.direction == "sensor":
                self.values[port.name] = [self._read(port.name, init.sensors) if init else UNKNOWN for init in inits]
            elif port.direction == "actuator":
                self.values[port.name] = [self._unset(port.name, init) for init in inits]

    def _import_first_values(self) -> None:
        """Set imported variables to the first values that their exporters give them, in this program's types."""
        applications = self._fleet.applications
        for each in applications[self._number].imports:
            exporter = applications[each.application]
            first = {v.name: msgspec.Raw(msgspec.json.encode(v.initial())) for v in exporter.own}
            for name in each.variables:
                value = self._one(name, first[name])
                self.values[name] = (value,) * len(exporter.members) if name in self._lists else value

    def advance(self) -> None:
        """Apply the available records of the next round; round 0 is `init`."""
        self.round += 1
        self.changes = []
        if self.round == 0:
            for instance in self._instances:
                if instance.init is not None:
                    if instance.application == self._number:
                        self._set_values(instance.pid, instance.init.locals, instance.init.actuators)
                    self._write(instance, instance.init.shared, "init")
            return
        records = [(n, record) for n, each in enumerate(self._instances) for record in self._due(each)]
        present = {n for n, record in records if record.round == self.round}
        self.lacking = {n for n, record in records if record.round < self.round}
        self.lacking |= {n for n, each in enumerate(self._instances) if n not in present and not each.stopped}
        if len(present) < len(self._instances):
            self._repair(records)
        records.sort(key=lambda pair: (pair[1].round, not self._is_atomic(*pair), pair[0]))
        for number, record in records:
            self._apply(self._instances[number], record)

    def _is_atomic(self, number: int, record: Round) -> bool:
        return self._locks[self._instances[number].application].get(record.event or "", False)

    def sensed(self, pid: int, name: str, round_: int) -> Any:
        """Return a sensor as sampled at the start of a round after `round`; UNKNOWN without a record."""
        record = self._own[pid].rounds.get(round_)
        return UNKNOWN if record is None else self._read(name, record.sensors)

    def _due(self, instance: _Instance) -> list[Round]:
        """Return the records to apply now. A late record is applied late."""
        instance.calls = ()
        return [instance.rounds.pop(round_) for round_ in sorted(instance.rounds) if round_ <= self.round]

    def _apply(self, instance: _Instance, record: Round) -> None:
        if instance.application == self._number:
            self._apply_own(instance.pid, record)
            instance.calls = tuple(
                (port, _arguments(args), self._one(port, answer)) for port, args, answer in record.calls
            )
        if instance.robot in self._members:
            self._clear(self._members.index(instance.robot), self._clears[instance.application], record.actuators)
        self._write(instance, record.shared, record.event or "")

    def _apply_own(self, pid: int, record: Round) -> None:
        for name in record.sensors:
            if name in self.values:
                self.values[name][pid] = self._read(name, record.sensors)
        if record.restored is not None:
            self._set_values(pid, record.restored.locals, record.restored.actuators)
        self._set_values(pid, record.locals, record.actuators)

    def _clear(self, pid: int, clears: Mapping[str, Collection[str]], actuators: Values) -> None:
        """Clear the sensors of a robot that a command to its body clears, whichever application commands the body."""
        for name in actuators:
            for sensor in clears.get(name, ()):
                if sensor in self.values:
                    self.values[sensor][pid] = False

    def _set_values(self, pid: int, *groups: Values) -> None:
        for group in groups:
            for name in group:
                self.values[name][pid] = self._read(name, group)

    def _write(self, writer: _Instance, written: Values, event: str) -> None:
        views = self._views[writer.application]
        for named, raw in written.items():
            name = views.get(named)
            if name is None:
                continue
            value = self._one(name, raw)
            before = self.value(name) if name in self._traced else None
            if name in self._slots:
                self.values[name][writer.pid] = value
            elif name in self._lists:
                self._set_slot(name, writer.pid, value)
            else:
                self.values[name] = value
            if name in self._traced:
                number = self._by_place[self._fleet.applications[writer.application].name, writer.robot]
                self.changes.append(SharedWrite(name, before, self.value(name), number, event))

    def value(self, name: str) -> Any:
        """Return the value of a shared variable, which later rounds do not change."""
        value = self.values[name]
        return list(value) if name in self._slots else value

    def _set_slot(self, name: str, pid: int, value: Any) -> None:
        """Set a slot of an imported allread variable. `pid`: of the slot's owner in the exporter."""
        slots = self.values[name]
        self.values[name] = (*slots[:pid], value, *slots[pid + 1 :])

    def _repair(self, records: Iterable[tuple[int, Round]]) -> None:
        """Recover writes of a robot that is gone from the copies of the others."""
        for number, record in records:
            application = self._instances[number].application
            views, owned = self._views[application], {v.name for v in self._fleet.applications[application].own}
            for named, raw in record.copy.items():
                name = views.get(named)
                if name is None:
                    continue
                if name not in self._slots and name not in self._lists:
                    self.values[name] = self._one(name, raw)
                    continue
                slots = _by_pid.decode(raw).items() if named in owned else enumerate(_by_index.decode(raw))
                for pid, own in slots:
                    if name in self._lists:
                        self._set_slot(name, int(pid), self._one(name, own))
                    else:
                        self.values[name][int(pid)] = self._one(name, own)

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


def _names_in(fleet: FleetProgram, application: int) -> list[dict[str, str]]:
    """Return for each application: name of a shared variable there -> its name in `application`, if it has one."""
    names = {stored: name for name, stored in fleet.views(application)}
    return [
        {name: names[stored] for name, stored in fleet.views(index) if stored in names}
        for index in range(len(fleet.applications))
    ]


def _arguments(args: tuple[msgspec.Raw, ...]) -> tuple[Any, ...]:
    return tuple(decoder.decode(raw) for decoder, raw in zip(_CALL_ARGUMENTS, args, strict=False))
