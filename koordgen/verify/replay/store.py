"""Shared store after each round, computed from the writes that robots recorded."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from koordgen.lang.semantics.composition import System
from koordgen.lang.semantics.step import initial
from koordgen.runtime.program.runner import NO_EVENT
from koordgen.verify.replay.values import plain

StoreKey = tuple[int, str]  # index of the application that declares a shared variable, and the variable's name there
# Store in JSON: shared variable -> value; for an allread variable, a list with one value per pid of its application.
Shown = Mapping[StoreKey, Any]


class RecordedWrite(NamedTuple):
    """Write of one shared variable by an instance; `pid`: its pid in the application."""

    application: int
    pid: int
    event: str
    key: StoreKey
    value: Any


class RecordedWrites:
    """Recorded writes of each round.

    The writes are applied in the same order as on robots: first commits, then plain events, both by instance.

    `slots`: the allread variables."""

    def __init__(self, system: System) -> None:
        self._system = system
        every = list(enumerate(system.applications))
        self._locks = [{event.name: event.lock is not None for event in a.program.events} for _, a in every]
        self._numbers = {(i.application, i.pid): number for number, i in enumerate(system.instances())}
        self._recorded: dict[int, list[tuple[tuple[bool, int], list[RecordedWrite]]]] = {}
        self._keys = [{v.name: (system.owner(index, v.name), v.name) for v in a.program.shared} for index, a in every]
        self._initial: dict[StoreKey, Any] = {}
        self.slots: set[StoreKey] = set()
        for index, application in every:
            store = initial(application.program, len(application.members)).store
            for variable in system.own(index):
                key = index, variable.name
                if variable.kind == "allread":
                    self.slots.add(key)
                    self._initial[key] = [plain(value) for value in store.slots[variable.name]]
                else:
                    self._initial[key] = plain(store.cells[variable.name])

    def keys(self, application: int) -> Mapping[str, StoreKey]:
        """Return the shared variables of an application, keyed by their names in its program."""
        return self._keys[application]

    def add_record(self, application: int, pid: int, record: Mapping[str, Any]) -> None:
        """Add the writes of one record (of a round, or of `init`) of an instance. `pid`: its pid in the application."""
        if record.get("shared"):
            plain_event = not self._locks[application].get(record.get("event") or "", False)
            order, keys = (plain_event, self._numbers[application, pid]), self._keys[application]
            # a name that is no variable of the program occurs in a damaged trace only
            writes = [
                RecordedWrite(application, pid, record.get("event") or "init", keys[name], value)
                for name, value in record["shared"].items()
                if name in keys
            ]
            self._recorded.setdefault(int(record.get("round", 0)), []).append((order, writes))

    def first(self) -> Shown:
        """Return the initial store, before any `init` has run."""
        return self._initial

    def after(self, store: Shown, round_: int) -> Shown:
        """Return the store after a round, computed from the store after the previous round.

        Round 0 is `init`."""
        if round_ not in self._recorded:
            return store
        found = dict(store)
        for write in self.ordered(round_):
            found[write.key] = self.written(found[write.key], write)
        return found

    def ordered(self, round_: int) -> list[RecordedWrite]:
        """Return the writes of a round in the order of their effects."""
        groups = sorted(self._recorded.get(round_, []), key=lambda group: group[0])
        return [write for _, writes in groups for write in writes]

    def written(self, before: Any, write: RecordedWrite) -> Any:
        """Return the value of a variable after a write; of an allread variable, all slots."""
        if write.key not in self.slots:
            return write.value
        return [write.value if p == write.pid else own for p, own in enumerate(before)]


def had_frame(record: Mapping[str, Any]) -> bool:
    """Return whether a robot read its copy of the store in a round.

    A robot reads the store in a round with an event, a discarded event, or no enabled event. In all other cases, the
    robot skips the round before it reads the store."""
    looked = record.get("event") is not None or record.get("fault") is not None
    return looked or record.get("skipped") == NO_EVENT
