"""States of a squad, a fleet that is one robot of another fleet, as its trace records them round by round.

The *outer* robot runs in one of the squad's robots, its host. The host keeps the checkpoint of the outer robot in the
squad's store, in the variable RECORD. That record tells which outer events came before an inner round, so the two
traces need no common clock."""

from __future__ import annotations

from base64 import b64decode
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, cached_property, lru_cache
from typing import Any, NamedTuple

from koordgen.lang.ir.decl import Program
from koordgen.lang.ir.stmt import Assign, SharedPlace
from koordgen.lang.ir.tree import walk
from koordgen.lang.semantics.eval import Discarded, evaluate
from koordgen.lang.semantics.exec import Budget, library
from koordgen.lang.semantics.state import World, nobody
from koordgen.lang.semantics.step import initial, no_port
from koordgen.lang.semantics.values import Value
from koordgen.runtime.agent.squad_record import HostRecord, read_record
from koordgen.runtime.program.property import UNKNOWN
from koordgen.runtime.values.points import Opaque
from koordgen.verify.audit.shared_store import AuditedFleet, SharedStore
from koordgen.verify.replay.hosted import RECORD, WRITE, provider_of
from koordgen.verify.replay.store import Shown
from koordgen.verify.replay.trace import TraceLine
from koordgen.verify.replay.values import BadValue, from_trace, plain

NO_VALUE = object()  # value of a provided sensor whose expression has no value in a state


class HostWrite(NamedTuple):
    """Write of the application that hosts the outer robot: an inner round, the robot's name and its record."""

    round: int
    robot: str
    line: TraceLine


class SquadStates:
    """States of a squad at the start of each inner round, and the writes of its host.

    `fleet`: the squad, whose last application hosts the outer robot. `externs`: extern functions of the application
    that provides the modules. `first`, `last`: the rounds of which `known` may return the state."""

    def __init__(self, fleet: AuditedFleet, externs: Mapping[str, Callable[..., Any]]) -> None:
        self._system, self._externs = fleet.system, externs
        self._provider = provider_of(fleet.system)
        self.program: Program = fleet.system.applications[self._provider].program
        self._n_sys = len(fleet.system.applications[self._provider].members)
        self._missions, self._host = fleet.missions, len(fleet.missions) - 1
        mission = fleet.missions[self._host]
        self.first, self.last = max(1, mission.first), mission.last + 1
        store = SharedStore(fleet, mission.first)
        self._keys, self._record_key = store.writes.keys(self._provider), (self._host, RECORD)
        self._states: dict[int, Shown] = {}
        for round_ in range(mission.first, mission.last + 1):
            store.advance(round_)
            self._states[round_ + 1] = store.values
        self._provided = {
            f"{module.name}.{provided.port.name}": provided
            for module in self.program.provides
            for provided in module.ports
            if provided.port.direction == "sensor"
        }
        self._sensors = cache(self._evaluated)

    @cached_property
    def writes(self) -> list[HostWrite]:
        """Writes of the hosts by round."""
        found = [
            HostWrite(round_, history.name, line)
            for history in self._missions[self._host].histories
            for round_, line in history.rounds.items()
            if line.record.get("event") == WRITE
        ]
        return sorted(found, key=lambda write: write.round)

    @cached_property
    def written_inside(self) -> set[str]:
        """Variables of the providing program that events of the inner programs write."""
        found = set()
        for index, application in enumerate(self._system.applications[: self._host]):
            places = [node.place for node in walk(application.program.events) if isinstance(node, Assign)]
            for place in places:
                if isinstance(place, SharedPlace) and self._system.owner(index, place.name) == self._provider:
                    found.add(place.name)
        return found

    def sensor(self, round_: int, name: str) -> Any:
        """Return a provided sensor in the state at the start of a round, in JSON.

        UNKNOWN if the state is not recorded, NO_VALUE if the expression has no value."""
        return self._sensors(round_).get(name, NO_VALUE)

    def variable(self, round_: int, name: str) -> Any:
        """Return a variable of the providing program at the start of a round, in JSON; UNKNOWN if not recorded."""
        state = self._states.get(round_)
        return UNKNOWN if state is None or name not in self._keys else state[self._keys[name]]

    def first_writes(self, mission: str) -> dict[int, int]:
        """Return outer round with an event, 0 for `init` -> the first inner round whose writes contain the event.

        `mission`: id of the outer mission, "" if unknown: records of other missions are left out."""
        found: dict[int, int] = {}
        for round_, record in self._records(mission):
            for each in record.locals:
                found.setdefault(each.round, round_)
        return found

    def applied(self, mission: str) -> list[tuple[int, int]]:
        """Return pairs (outer round, inner round), ascending: the outer robot had applied the outer round before the
        writes of the inner round. `mission`: see first_writes."""
        found: list[tuple[int, int]] = []
        for round_, record in self._records(mission):
            applied = -1 if record.acceptor is None else record.acceptor.applied
            if not found or applied > found[-1][0]:
                found.append((applied, round_))
        return found

    def _records(self, mission: str) -> Iterator[tuple[int, HostRecord]]:
        """Yield the record after each round in which it is known and changed."""
        before = None
        for round_ in range(self.first, self.last):
            value = self._states[round_ + 1][self._record_key]
            if value is UNKNOWN or value == before:
                continue
            before, record = value, _record(value[0])
            if not mission or (record.mission is not None and record.mission.epoch.hex() == mission):
                yield round_, record

    def has_rejoined_host(self, rounds: range) -> bool:
        """Return whether a host rejoined the squad in one of these rounds.

        The others may then have discarded a state that the outer robot had read. No trace has such a state."""
        hosts = self._hosts(rounds)
        histories = self._missions[self._host].histories
        return any(
            round_ in rounds and line.record.get("restored") is not None
            for history in histories
            if history.pid in hosts
            for round_, line in history.rounds.items()
        )

    def has_one_host(self, rounds: range) -> bool:
        """Return whether one robot only was the host in these rounds."""
        return len(self._hosts(rounds)) < 2

    def _hosts(self, rounds: range) -> set[int]:
        values = [self._states[k][self._record_key] for k in rounds if k in self._states]
        return {_record(value[0]).pid for value in values if value is not UNKNOWN}

    def has_same_record(self, first: int, second: int) -> bool:
        """Return whether the record may be the same at the start of two rounds: it is, or one of them is unknown."""
        values = [self._states[k][self._record_key] if k in self._states else UNKNOWN for k in (first, second)]
        return UNKNOWN in values or values[0] == values[1]

    def line(self, round_: int) -> int:
        """Return the line of the record of some robot in a round; 0 if there is none."""
        for mission in self._missions:
            for history in mission.histories:
                if round_ in history.rounds:
                    return history.rounds[round_].number
        return 0

    def _evaluated(self, round_: int) -> dict[str, Any]:
        state = self._states.get(round_)
        values = {} if state is None else {name: state[key] for name, key in self._keys.items()}
        if state is None or any(v is UNKNOWN or (isinstance(v, list) and UNKNOWN in v) for v in values.values()):
            return dict.fromkeys(self._provided, UNKNOWN)
        try:
            slots, cells = self._split(values)
        except BadValue:
            return dict.fromkeys(self._provided, UNKNOWN)
        world = World(self._externs, nobody)
        found: dict[str, Any] = {}
        for name, provided in self._provided.items():
            view = library(self.program, self._n_sys, self._params, world, Budget(world.turns), no_port)
            try:
                found[name] = plain(evaluate(provided.value, view._replace(slots=slots, cells=cells)))
            except Discarded:
                found[name] = NO_VALUE
        return found

    def _split(self, values: Mapping[str, Any]) -> tuple[dict[str, Sequence[Value]], dict[str, Value]]:
        """Return the values of allread variables by pid, and those of allwrite variables. Raises BadValue."""
        slots: dict[str, Sequence[Value]] = {}
        cells: dict[str, Value] = {}
        for variable in self.program.shared:
            value = values[variable.name]
            if variable.kind == "allread":
                slots[variable.name] = tuple([from_trace(own, variable.type) for own in value])
            else:
                cells[variable.name] = from_trace(value, variable.type)
        return slots, cells

    @cached_property
    def _params(self) -> Mapping[str, Value]:
        return initial(self.program, self._n_sys).params


@lru_cache
def _record(value: str) -> HostRecord:
    """Return the record in a value of the variable; the first record if no host wrote the value."""
    try:
        return read_record(Opaque(b64decode(value, validate=True)))
    except (ValueError, TypeError):
        return HostRecord()
