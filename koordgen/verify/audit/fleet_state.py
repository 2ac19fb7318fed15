"""State of the whole fleet in each round, as far as the traces of the robots record it.

The state is observed twice in a round. The first observation is right after the round's events, with the sensor values
of the round's start. The second observation is at the round's end, with the sensor values of the next round's start.
Robots sample no sensors between these times.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from koordgen.lang.ir.ports import clears
from koordgen.runtime.program.program import Calls
from koordgen.runtime.program.property import UNKNOWN
from koordgen.verify.audit.history import RobotHistory
from koordgen.verify.audit.properties import GeneratedProperties
from koordgen.verify.audit.shared_store import AuditedFleet, SharedStore
from koordgen.verify.replay.store import StoreKey


class SharedChange(NamedTuple):
    """Change of a shared variable by one write, or by all writes of a round whose writes are not all known.

    `before`, `after`: values for generated code. `cause`: the write, as text. `robots`: name of the writing robot.
    `is_single`: whether it is one recorded write. Of several writes, one may break what the values at the ends keep."""

    before: Any
    after: Any
    cause: str
    robots: tuple[str, ...]
    is_single: bool = True


class FleetState:
    """State of the members of an application at one observation. `advance` and `end` move on to the next observation.

    `values`: name -> value, in the form that generated properties read. A local variable, a port and an allread
        variable have a list with one value for each pid; an allwrite variable has one value. Values that no trace
        records are UNKNOWN.
    `round`: the last round whose effects `values` contains; at first, the round before `mission.first`."""

    def __init__(self, meaning: GeneratedProperties, fleet: AuditedFleet, index: int) -> None:
        mission, members = fleet.missions[index], fleet.system.applications[index].members
        histories = mission.histories
        self.round = mission.first - 1
        self.values: dict[str, Any] = {}
        self._meaning, self._histories = meaning, histories
        # for each member, the histories of its robot in all applications, and the sensors that commands there clear
        self._on_robot = [
            [
                (fleet.missions[other].histories[application.members.index(robot)], clears(application.program))
                for other, application in enumerate(fleet.system.applications)
                if robot in application.members
            ]
            for robot in members
        ]
        program = meaning.program
        ports = [(f"{m.name}.{p.name}", p.direction) for m in program.modules for p in m.ports]
        self.sensors = [name for name, direction in ports if direction == "sensor"]
        self._actuators = [name for name, direction in ports if direction == "actuator"]
        self._locals = [v.name for v in program.locals]
        # locals and actuators of each robot, also after the robot has stopped or was removed from the fleet
        self._own: list[dict[str, Any]] = [{} for _ in histories]
        self._shared = _Shared(meaning, fleet, index)
        if mission.first:
            names = [*self._locals, *self.sensors, *self._actuators, *(v.name for v in program.shared)]
            self.values = {name: [UNKNOWN] * len(histories) for name in names}
            self.values |= {v.name: UNKNOWN for v in program.shared if v.kind == "allwrite"}
        else:
            self._begin()

    def _begin(self) -> None:
        """Set the values before `init`: initial values of variables, first samples, and unset actuators.

        A robot holds its position until the first command for some actuators, such as a target. The value of such an
        actuator is the position."""
        found, n = self._meaning.found.program, len(self._histories)
        for variable in (*found.locals, *found.shared):
            first = variable.initial()
            self.values[variable.name] = first if variable.kind == "allwrite" else [first] * n
        self._sample(0)
        for port in (p for p in found.ports if p.name in self._actuators):
            value = port.unset() if port.unset is not None and not port.held else UNKNOWN
            self.values[port.name] = self.values.get(port.held, [value] * n)

    def advance(self) -> None:
        """Set the state to the first observation of the next round, right after its events. Round 0 is `init`."""
        self.round += 1
        for pid, history in enumerate(self._histories):
            self._act(pid, history)
        for name in self._locals:
            self.values[name] = [own.get(name, UNKNOWN) for own in self._own]
        self._sample(self.round)
        for pid in range(len(self._histories)):
            self._clear(pid)
        for name in self._actuators:
            self.values[name] = [
                UNKNOWN if history.out_at(self.round) else own.get(name, UNKNOWN)
                for own, history in zip(self._own, self._histories, strict=True)
            ]
        self.values.update(self._shared.after(self.round))

    def end(self) -> None:
        """Set the state to the second observation of the present round, at the round's end."""
        self._sample(self.round + 1)

    def sampled(self, pid: int, round_: int) -> dict[str, Any]:
        """Return a robot's sensor values at the start of a round; UNKNOWN if it takes no part in the round."""
        history = self._histories[pid]
        recorded = self.record(pid, round_).get("sensors", {})
        if history.out_at(round_):
            recorded = {}
        return {name: self._meaning.value(name, recorded.get(name, UNKNOWN)) for name in self.sensors}

    def record(self, pid: int, round_: int) -> Mapping[str, Any]:
        return _record(self._histories[pid], round_)

    def calls(self, pid: int) -> Calls | None:
        """Return a robot's port calls in the present round; None if an argument or answer is unknown."""
        recorded = self.record(pid, self.round).get("calls", [])
        calls = tuple([self._meaning.call(port, args, answer) for port, args, answer in recorded])
        return None if any(answer is UNKNOWN or UNKNOWN in args for _, args, answer in calls) else calls

    def changes(self, variable: str) -> list[SharedChange]:
        """Return the changes of one of the application's own variables in the present round, in their order."""
        return self._shared.changes(variable)

    def _act(self, pid: int, history: RobotHistory) -> None:
        own, record = self._own[pid], self.record(pid, self.round)
        if self.round in history.turns:
            own.clear()
            self._record_own(own, history.turns[self.round] or {})
        self._record_own(own, record.get("restored") or {})
        self._record_own(own, record)

    def _record_own(self, own: dict[str, Any], recorded: Mapping[str, Any]) -> None:
        for group in ("locals", "actuators"):
            own.update(self._meaning.values(recorded.get(group, {})))

    def _clear(self, pid: int) -> None:
        """Set each sensor to false that a command of robot `pid` in the present round clears.

        The sensors stay false until the robot samples them at the start of the next round."""
        for history, cleared in self._on_robot[pid]:
            for name in _record(history, self.round).get("actuators", {}) if self.round else ():
                for sensor in cleared.get(name, ()):
                    if sensor in self.values and self.values[sensor][pid] is not UNKNOWN:
                        self.values[sensor][pid] = False

    def _sample(self, round_: int) -> None:
        samples = [self.sampled(pid, round_) for pid in range(len(self._histories))]
        for name in self.sensors:
            self.values[name] = [sample[name] for sample in samples]


def _record(history: RobotHistory, round_: int) -> Mapping[str, Any]:
    if round_ == 0:
        return history.init or {}
    return history.rounds[round_].record if round_ in history.rounds else {}


class _Shared:
    """Values of the shared variables of one application's program after each round, for generated code."""

    def __init__(self, meaning: GeneratedProperties, fleet: AuditedFleet, index: int) -> None:
        self._meaning, self._index, self._system, self._missions = meaning, index, fleet.system, fleet.missions
        self._store = SharedStore(fleet, fleet.missions[index].first)
        self._writes = self._store.writes
        # JSON values of the program's variables at the last conversion; `_values` holds the converted values
        self._converted: dict[str, Any] = {}
        self._values: dict[str, Any] = {}
        self._round = 0

    def after(self, round_: int) -> dict[str, Any]:
        """Return the values of the shared variables after a round. Call this for all rounds in order."""
        self._round = round_
        self._store.advance(round_)
        for name, key in self._writes.keys(self._index).items():
            recorded = self._store.values[key]
            if name not in self._converted or self._converted[name] != recorded:
                self._values[name] = self._value(name, key, recorded)
                self._converted[name] = recorded
        return self._values

    def changes(self, variable: str) -> list[SharedChange]:
        """See FleetState.changes. In a round in which a write may lack a record, all writes together are one change."""
        key = self._index, variable
        before, after = self._store.before[key], self._store.values[key]
        names = [application.name for application in self._system.applications]
        if self._store.may_lack_writes(self._round, key):
            cause = "by writes of this round, not all of which were recorded"
            return [self._change(variable, before, after, cause, ())._replace(is_single=False)]
        found = []
        for write in self._writes.ordered(self._round):
            if write.key == key:
                later = self._writes.written(before, write)
                robot = self._missions[write.application].histories[write.pid].name
                of = f" of {names[write.application]}" if len(names) > 1 else ""
                found.append(self._change(variable, before, later, f"by {write.event}{of} on {robot}", (robot,)))
                before = later
        return found

    def _change(self, variable: str, before: Any, after: Any, cause: str, robots: tuple[str, ...]) -> SharedChange:
        key = self._index, variable
        return SharedChange(self._value(variable, key, before), self._value(variable, key, after), cause, robots)

    def _value(self, name: str, key: StoreKey, recorded: Any) -> Any:
        of = self._meaning.value
        # an imported allread variable is a list, which is unknown as a whole if one of its slots is
        is_own_slots = key in self._writes.slots and key[0] == self._index
        return [of(name, own) for own in recorded] if is_own_slots else of(name, recorded)
