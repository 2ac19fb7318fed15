"""Shared store of a fleet after each round, as far as the traces of the robots record it."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from koordgen.lang.semantics.composition import System
from koordgen.runtime.program.property import UNKNOWN
from koordgen.verify.audit.history import FleetMission, RobotHistory
from koordgen.verify.replay.store import RecordedWrites, StoreKey, had_frame


class AuditedFleet(NamedTuple):
    """Applications of a fleet, each with the mission as its members recorded it. `missions`: by application."""

    system: System
    missions: tuple[FleetMission, ...]

    def written(self, index: int) -> set[StoreKey]:
        """Return the shared variables that an application can write."""
        program = self.system.applications[index].program
        own = {(index, variable.name) for variable in self.system.own(index)}
        return own | {(self.system.owner(index, name), name) for each in program.imports for name in each.written}


class SharedStore:
    """Values of all shared variables after each round, in JSON; UNKNOWN if no trace records the value.

    The values come from the copies that robots read at the start of the next round, in any application. Values that no
    copy contains are computed from the recorded writes.

    `first`: the first round whose values are to be known. `writes`: the recorded writes. `values`, `before`: the store
    after the last round, and the store before it."""

    def __init__(self, fleet: AuditedFleet, first: int) -> None:
        self.writes = RecordedWrites(fleet.system)
        self._instances = [
            _Instance(history, application, self.writes.keys(application), fleet.written(application))
            for application, mission in enumerate(fleet.missions)
            for history in mission.histories
        ]
        for each in self._instances:
            history = each.history
            for record in [history.init or {}, *[line.record for line in history.rounds.values()]]:
                self.writes.add_record(each.application, history.pid, record)
        self.values: dict[StoreKey, Any] = dict(self.writes.first())
        self.before = self.values
        if first:  # earlier rounds are missing, so the values before the first recorded round are unknown
            for each in self._instances:
                self._lose(each)
                self._see(each, first)

    def advance(self, round_: int) -> None:
        """Set the values to those after a round. Call this for all rounds in order."""
        self.before = dict(self.values)
        self.values = dict(self.writes.after(self.values, round_))
        for each in self._instances:
            if each.history.may_act(round_):
                self._lose(each)
        for each in self._instances:
            self._see(each, round_ + 1)

    def may_lack_writes(self, round_: int, key: StoreKey) -> bool:
        """Return whether an instance may have written a variable in a round without a record."""
        return any(each.history.may_act(round_) for each in self._instances if key in each.written)

    def _lose(self, each: _Instance) -> None:
        """Set each slot and allwrite variable that an instance can write to UNKNOWN."""
        for key in each.written:
            held = self.values[key]
            if key in self.writes.slots:
                self.values[key] = [UNKNOWN if p == each.history.pid else own for p, own in enumerate(held)]
            else:
                self.values[key] = UNKNOWN

    def _see(self, each: _Instance, round_: int) -> None:
        """Update the shared variables with the copy that an instance read at the start of a round."""
        history, copy = each.history, each.copy
        if history.turns.get(round_, copy) is None:
            copy.clear()
        line = history.rounds.get(round_)
        if line is None or not had_frame(line.record):
            return
        recorded = line.record.get("copy", {})
        for name, held in recorded.items():
            key = each.keys.get(name)
            if key not in self.writes.slots:
                copy[name] = held
            elif isinstance(held, list):  # an imported allread variable is a list of all slots
                copy[name] = dict(enumerate(held))
            elif isinstance(held, dict):
                copy.setdefault(name, {}).update(
                    {int(p): own for p, own in held.items() if p.isdecimal() and len(p) < 10}
                )
        for name, key in each.keys.items():
            if key in self.writes.slots:
                slots = copy.get(name, {})
                self.values[key] = [slots.get(p, own) for p, own in enumerate(self.values[key])]
            elif name in copy:
                self.values[key] = copy[name]
        for name, own in line.record.get("shared", {}).items():
            if each.keys.get(name) in self.writes.slots:
                copy.setdefault(name, {})[history.pid] = own


@dataclass
class _Instance:
    """Instance of an application, with its copy of the shared variables.

    `keys`: the shared variables of its program, by their names there. `written`: those that it can write.
    `copy`: name -> value; the copy of an allread variable is a dictionary by pid."""

    history: RobotHistory
    application: int
    keys: Mapping[str, StoreKey]
    written: Collection[StoreKey]
    copy: dict[str, Any] = field(default_factory=dict)
