"""Squad: a fleet that is one robot of another fleet.

The squad's own robots form the *inner* fleet; the *outer* fleet has the squad as one robot. The agent of the outer
robot runs on one inner robot, its *host*. It needs two things of the inner fleet: to write the variables that take its
commands, and to keep its checkpoint in a store that outlives the host. Both are done by one more application of the
inner fleet, which is built here: it declares the hidden variable RECORD and has one instance on each inner robot."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from hashlib import blake2s
from typing import Any, Protocol

from koordgen.runtime.agent.checkpoint import rooms
from koordgen.runtime.agent.records import KEPT
from koordgen.runtime.program.fleet_program import FleetApplication, FleetProgram, ImportBinding
from koordgen.runtime.program.program import Event, Frame, Port, Program, Transaction, Variable
from koordgen.runtime.values.bounds import NUMBER, Blob, Fixed
from koordgen.runtime.values.points import Opaque
from koordgen.runtime.values.turns import begin

APPLICATION = "outer"  # name of the application that is added to the inner fleet
RECORD = "(record)"  # its variable; no variable of a program has such a name
STORED = f"{APPLICATION}.{RECORD}"
MODULE = "Outer"  # module of the application, which the host serves
WRITTEN = f"{MODULE}.written"  # actuator: version of the record; it is commanded once the write is committed
SHARE = 0.05  # part of the time for events that the application's events may take
HEAD = 64  # largest number of bytes of a record without the records of the checkpoint


class HostEvents(Protocol):
    """Guards and effects of the application's events, on one inner robot."""

    def may_claim(self, s: Transaction) -> bool: ...

    def claim(self, s: Transaction) -> None: ...

    def has_unwritten(self, s: Transaction) -> bool: ...

    def write(self, s: Transaction) -> None: ...


@dataclass(frozen=True)
class Squad:
    """Inner fleet as one robot of an outer fleet, as the bundles of its robots describe it.

    application: number of the inner application that provides the modules of the outer robot.
    sensors: port of the outer robot, such as `Motion.position` -> its value, a function of the inner program's state.
    actuators: port of the outer robot -> variable of the inner program that takes its commands.
    program: program of the outer fleet.
    settings: file with the settings of the outer robot.
    """

    application: int
    sensors: Mapping[str, Callable[[Any], Any]]
    actuators: Mapping[str, str]
    program: Program
    properties: Any = None
    settings: str = "outer.json"

    def with_outer(self, inner: FleetProgram, robots: int, events: HostEvents) -> FleetProgram:
        """Return the inner fleet with the application that hosts the outer robot, numbered last.

        robots: number of robots of the outer fleet. events: see HostEvents.
        """
        commanded = tuple(self.actuators.values())
        hashes = [joined_hash(inner.program_hash, self.program.program_hash)]
        hashes.append(joined_hash(inner.interface_hash, self.program.interface_hash))
        added = FleetApplication(
            APPLICATION,
            self._program(inner.applications[self.application].program, robots, events),
            tuple(range(inner.robots)),
            (ImportBinding("Squad", self.application, commanded, commanded),),
            share=SHARE,
        )
        return FleetProgram((*inner.applications, added), inner.robots, *hashes)

    def _program(self, providing: Program, robots: int, events: HostEvents) -> Program:
        bound = Blob(record_capacity(self.program, robots), "record")
        record = Variable(RECORD, "allwrite", Opaque, bound, Opaque)
        return Program(
            name=APPLICATION,
            source=self.program.source,
            program_hash=self.program.program_hash,
            interface_hash=self.program.interface_hash,
            locals=(),
            shared=(record, *[v for v in providing.shared if v.name in self.actuators.values()]),
            ports=(Port(WRITTEN, "actuator", int, Fixed(NUMBER), unset=int),),
            init=None,
            events=(
                Event("Claim", 0, events.may_claim, events.claim),
                Event("Write", 0, events.has_unwritten, events.write),
            ),
            begin=Transaction,
            file="",
            lines={},
        )


def record_capacity(program: Program, robots: int) -> int:
    """Return the largest number of bytes of the record of an outer robot.

    program: program of the outer fleet. robots: its number of robots.
    """
    mission, locals_, acceptor = rooms(program, robots, 1)
    return HEAD + mission + (KEPT + 1) * locals_ + acceptor


class SensorValues:
    """Values of an outer robot's sensors in a state of the inner fleet's store."""

    def __init__(self, squad: Squad, inner: FleetProgram) -> None:
        self._sensors = squad.sensors
        self._application = inner.applications[squad.application]
        self._views = inner.views(squad.application)
        self._seen: Mapping[str, Any] | None = None
        self._values: dict[str, Any] = {}

    def of(self, store: Mapping[str, Any]) -> dict[str, Any]:
        """Return port -> value; None for a sensor without a value in this state."""
        if store is not self._seen:
            self._seen = store
            state = self._application.program.begin(self._frame(store))
            self._values = {port: _value(value, state) for port, value in self._sensors.items()}
        return self._values

    def _frame(self, store: Mapping[str, Any]) -> Frame:
        """Return a state that has only shared variables: a provided sensor reads nothing else."""
        shared = {name: store[stored] for name, stored in self._views}
        return Frame(0, len(self._application.members), self._locals, shared, _Absent(), _Absent())

    @cached_property
    def _locals(self) -> Mapping[str, Any]:
        return {v.name: v.initial() for v in self._application.program.locals}


class _Absent(dict[str, Any]):
    """Ports without a value."""

    def __missing__(self, name: str) -> None:
        return None


def _value(function: Callable[[Any], Any], state: Transaction) -> Any:
    begin()
    try:
        return function(state)
    except Exception:  # as in a guard: an expression without a value, such as a division by zero
        return None


def joined_hash(first: str, second: str) -> str:
    """Return a hash, 16 hexadecimal digits, of two hashes."""
    return blake2s(f"{first} {second}".encode(), digest_size=8).hexdigest()
