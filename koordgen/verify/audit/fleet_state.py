"""State of the whole fleet, round by round, as far as the robots' traces contain it.

Each round has two observations: right after the round's events, with the sensor values of the round's start; and at the
round's end, with the sensor values of the next round's start. Robots take no samples between these times.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from koordgen.runtime.program.program import Calls
from koordgen.runtime.program.property import UNKNOWN
from koordgen.verify.audit.history import FleetMission, RobotHistory
from koordgen.verify.audit.properties import GeneratedProperties
from koordgen.verify.replay.store import RecordedWrites, had_frame


class FleetState:
    """State of the fleet, advanced from round to round.

    `values`: name -> value, in the form that generated properties read. A local variable, a port and an allread
        variable have a list with one value per pid; an allwrite variable has one value. A value is UNKNOWN if no trace
        contains it.
    `round`: the last round whose events are contained in `values`. At first it is the round before the mission's
        `first`."""

    def __init__(self, meaning: GeneratedProperties, mission: FleetMission) -> None:
        histories = mission.histories
        self.round = mission.first - 1
        self.values: dict[str, Any] = {}
        self._meaning, self._stories = meaning, histories
        self._clears = meaning.found.program.clears
        program = meaning.program
        ports = [(f"{m.name}.{p.name}", p.direction) for m in program.modules for p in m.ports]
        self.sensors = [name for name, direction in ports if direction == "sensor"]
        self._actuators = [name for name, direction in ports if direction == "actuator"]
        self._locals = [v.name for v in program.locals]
        # each robot's locals and actuators, also while the robot is outside of the model
        self._own: list[dict[str, Any]] = [{} for _ in histories]
        self._shared = _Shared(meaning, histories, mission.first)
        if mission.first:
            names = [*self._locals, *self.sensors, *self._actuators, *(v.name for v in program.shared)]
            self.values = {name: [UNKNOWN] * len(histories) for name in names}
            self.values |= {v.name: UNKNOWN for v in program.shared if v.kind == "allwrite"}
        else:
            self._begin()

    def _begin(self) -> None:
        """Set the values before `init`: variables have initial values, actuators are unset.

        A target that is unset has the value of the robot's position."""
        found, n = self._meaning.found.program, len(self._stories)
        for variable in (*found.locals, *found.shared):
            first = variable.initial()
            self.values[variable.name] = first if variable.kind == "allwrite" else [first] * n
        self._sample(0)
        for port in (p for p in found.ports if p.name in self._actuators):
            value = port.unset() if port.unset is not None and not port.held else UNKNOWN
            self.values[port.name] = self.values.get(port.held, [value] * n)

    def advance(self) -> None:
        """Advance to the observation right after the next round's events. Round 0 is `init`."""
        self.round += 1
        for pid, history in enumerate(self._stories):
            self._act(pid, history)
        for name in self._locals:
            self.values[name] = [own.get(name, UNKNOWN) for own in self._own]
        self._sample(self.round)
        for pid in range(len(self._stories)):
            self._clear(pid)
        for name in self._actuators:
            self.values[name] = [
                UNKNOWN if history.out_at(self.round) else own.get(name, UNKNOWN)
                for own, history in zip(self._own, self._stories, strict=True)
            ]
        self.values.update(self._shared.after(self.round))

    def end(self) -> None:
        """Advance to the observation at the end of this round."""
        self._sample(self.round + 1)

    def sampled(self, pid: int, round_: int) -> dict[str, Any]:
        """Return a robot's sensor values at the start of a round; UNKNOWN while it is outside of the model."""
        history = self._stories[pid]
        told = self.record(pid, round_).get("sensors", {})
        if history.out_at(round_):
            told = {}
        return {name: self._meaning.value(name, told.get(name, UNKNOWN)) for name in self.sensors}

    def record(self, pid: int, round_: int) -> Mapping[str, Any]:
        history = self._stories[pid]
        if round_ == 0:
            return history.init or {}
        return history.rounds[round_].record if round_ in history.rounds else {}

    def calls(self, pid: int) -> Calls | None:
        """Return the robot's calls of callable ports in this round; None if a value in one of them is unknown."""
        told = self.record(pid, self.round).get("calls", [])
        calls = tuple([self._meaning.call(port, args, answer) for port, args, answer in told])
        return None if any(answer is UNKNOWN or UNKNOWN in args for _, args, answer in calls) else calls

    def _act(self, pid: int, history: RobotHistory) -> None:
        own, record = self._own[pid], self.record(pid, self.round)
        if self.round in history.turns:
            own.clear()
            self._take(own, history.turns[self.round] or {})
        self._take(own, record.get("restored") or {})
        self._take(own, record)

    def _take(self, own: dict[str, Any], told: Mapping[str, Any]) -> None:
        for group in ("locals", "actuators"):
            own.update(self._meaning.values(told.get(group, {})))

    def _clear(self, pid: int) -> None:
        """Set the sensors that the robot's commands clear to false.

        They stay false until the robot's next sample."""
        for name in self.record(pid, self.round).get("actuators", {}) if self.round else ():
            for sensor in self._clears.get(name, ()):
                if self.values[sensor][pid] is not UNKNOWN:
                    self.values[sensor][pid] = False

    def _sample(self, round_: int) -> None:
        samples = [self.sampled(pid, round_) for pid in range(len(self._stories))]
        for name in self.sensors:
            self.values[name] = [sample[name] for sample in samples]


class _Shared:
    """Shared store after each round.

    The store is taken from robots' copies at the start of the next round. Values that no copy contains are computed
    from recorded writes."""

    def __init__(self, meaning: GeneratedProperties, histories: list[RobotHistory], first: int) -> None:
        self._meaning, self._stories = meaning, histories
        self._writes = RecordedWrites(meaning.program, len(histories))
        for history in histories:
            for record in [history.init or {}, *[line.record for line in history.rounds.values()]]:
                self._writes.add_record(history.pid, record)
        self._store: dict[str, Any] = dict(self._writes.first())
        # for each robot, its copy of the store; an allread variable is a dictionary by pid
        self._copies: list[dict[str, Any]] = [{} for _ in histories]
        self._told: dict[str, Any] = {}  # the values of `_store` that were already converted for `_values`, as in JSON
        self._values: dict[str, Any] = {}
        if first:  # if earlier rounds are missing, the store before the first record is unknown
            for history in histories:
                self._lose(history.pid)
                self._see(history, first)

    def after(self, round_: int) -> dict[str, Any]:
        """Return the store after a round. Call this for each round in ascending order."""
        self._store = dict(self._writes.after(self._store, round_))
        for history in self._stories:
            if history.may_act(round_):
                self._lose(history.pid)
        for history in self._stories:
            self._see(history, round_ + 1)
        for name, told in self._store.items():
            if name not in self._told or self._told[name] != told:
                slots = name in self._writes.slots
                of = self._meaning.value
                self._values[name] = [of(name, own) for own in told] if slots else of(name, told)
                self._told[name] = told
        return self._values

    def _lose(self, pid: int) -> None:
        """Set all values to UNKNOWN that this robot may have written in a round without a record."""
        for name, held in self._store.items():
            if name in self._writes.slots:
                self._store[name] = [UNKNOWN if p == pid else own for p, own in enumerate(held)]
            else:
                self._store[name] = UNKNOWN

    def _see(self, history: RobotHistory, round_: int) -> None:
        """Update the store with the copy that a robot read at the start of a round."""
        copy = self._copies[history.pid]
        if history.turns.get(round_, copy) is None:
            copy.clear()
        line = history.rounds.get(round_)
        if line is None or not had_frame(line.record):
            return
        told = line.record.get("copy", {})
        for name, held in told.items():
            if name not in self._writes.slots:
                copy[name] = held
            elif isinstance(held, dict):
                copy.setdefault(name, {}).update(
                    {int(p): own for p, own in held.items() if p.isdecimal() and len(p) < 10}
                )
        for name, held in self._store.items():
            if name in self._writes.slots:
                slots = copy.get(name, {})
                self._store[name] = [slots.get(p, own) for p, own in enumerate(held)]
            elif name in copy:
                self._store[name] = copy[name]
        for name, own in line.record.get("shared", {}).items():
            if name in self._writes.slots:
                copy.setdefault(name, {})[history.pid] = own
