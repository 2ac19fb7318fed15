"""Programs of a fleet: one application, or several with shared variables across them.

An *instance* is an application at work on one robot. Instances are numbered application by application, and within an
application by pid: the robot's place among the application's members. With one application on all robots, the number
of an instance is the robot's number, and all names are those of the program. With several applications, the name of a
variable in the shared store is `application.variable`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from koordgen.runtime.program.program import Port, Program, Transaction, Variable


@dataclass(frozen=True, slots=True)
class ImportBinding:
    """Import of a program, bound to the application that exports the variables.

    name: name of the import in the program, such as `Mapping`.
    application: number of the exporting application.
    variables: names of the imported variables; those in `written` may be written by the importer.
    """

    name: str
    application: int
    variables: tuple[str, ...]
    written: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class FleetApplication:
    """Application of a fleet.

    program: the generated program. It sees imported variables under their own names.
    members: robots that run the program, ascending; a robot's pid in this application is its index here.
    locks: for each lock of the program, the lock of the fleet that protects the same variables. A lock of the fleet
        protects variables that occur in one atomic event of some application.
    share: part of a robot's time for events that this application may use; None: it divides the rest equally with
        others. If the shares on a robot do not add up to 1, they are scaled.
    program_hash: hash of the program in the build that made this description; "" if it is not to be compared.
    """

    name: str
    program: Program
    members: tuple[int, ...]
    imports: tuple[ImportBinding, ...] = ()
    locks: tuple[int, ...] = ()
    share: float | None = None
    program_hash: str = ""

    @property
    def own(self) -> tuple[Variable, ...]:
        """Shared variables that the application itself declares."""
        imported = {name for each in self.imports for name in each.variables}
        return tuple([v for v in self.program.shared if v.name not in imported])


@dataclass(frozen=True, slots=True)
class RobotInstance:
    """Instance: its number, the number of its application, its pid there, and its robot."""

    number: int
    application: int
    pid: int
    robot: int


@dataclass(frozen=True, slots=True)
class StoreAccess:
    """Variables and locks of the shared store that one application may use.

    members: robots that run the application. An allread variable has a slot for each of them.
    owned: number of variables that the application declares; they follow those of earlier applications.
    indices: name in the program -> index in the store, of the variables that the application may write.
    locks: locks that the application's events may want; None: any.
    """

    members: tuple[int, ...]
    owned: int
    indices: Mapping[str, int]
    locks: frozenset[int] | None = None


@dataclass(frozen=True)
class FleetProgram:
    """All applications of a fleet of `robots` robots, in the order of the fleet file.

    The hashes cover all applications; see Program.
    """

    applications: tuple[FleetApplication, ...]
    robots: int
    program_hash: str
    interface_hash: str

    @classmethod
    def alone(cls, program: Program, robots: int) -> FleetProgram:
        """Return a fleet with one application on all robots."""
        locks = tuple(range(len(program.locks)))
        only = FleetApplication(program.name, program, tuple(range(robots)), locks=locks)
        return cls((only,), robots, program.program_hash, program.interface_hash)

    @property
    def name(self) -> str:
        """Names of all applications, joined by `+`."""
        return "+".join([application.name for application in self.applications])

    @property
    def is_composed(self) -> bool:
        """True if there are several applications, so that names have to distinguish them."""
        return len(self.applications) > 1

    @cached_property
    def instances(self) -> tuple[RobotInstance, ...]:
        """All instances by their numbers."""
        pairs = [
            (index, pid, robot)
            for index, application in enumerate(self.applications)
            for pid, robot in enumerate(application.members)
        ]
        return tuple([RobotInstance(number, *pair) for number, pair in enumerate(pairs)])

    def of_robot(self, robot: int) -> tuple[RobotInstance, ...]:
        """Return the instances of a robot by their numbers."""
        return tuple([instance for instance in self.instances if instance.robot == robot])

    def share(self, instance: RobotInstance) -> float:
        """Return the weight of an instance when its robot divides the time for events."""
        shares = [self.applications[each.application].share for each in self.of_robot(instance.robot)]
        rest = max(0.01, 1.0 - sum([share for share in shares if share is not None]))
        own = self.applications[instance.application].share
        return rest / shares.count(None) if own is None else own

    def stored(self, application: int, variable: str) -> str:
        """Return the name in the store of a variable that the program of `application` calls `variable`."""
        if not self.is_composed:
            return variable
        these = self.applications[application]
        owner = next((each.application for each in these.imports if variable in each.variables), application)
        return f"{self.applications[owner].name}.{variable}"

    def views(self, application: int) -> tuple[tuple[str, str], ...]:
        """Return the pairs (name in the program, name in the store) of the shared variables of an application."""
        return tuple(
            [(v.name, self.stored(application, v.name)) for v in self.applications[application].program.shared]
        )

    def names(self) -> dict[tuple[str, str], str]:
        """Return (application, name in its program) -> name in the store, of all shared variables.

        With one application the name of the application is left out: "".
        """
        return {
            (application.name if self.is_composed else "", name): stored
            for index, application in enumerate(self.applications)
            for name, stored in self.views(index)
        }

    def members_of(self, stored: str) -> tuple[int, ...]:
        """Return the robots that have a slot of an allread variable of the store; empty for other variables."""
        for index, application in enumerate(self.applications):
            if stored in [self.stored(index, v.name) for v in application.own if v.kind == "allread"]:
                return application.members
        return ()

    def shared(self) -> tuple[Variable, ...]:
        """Return the variables of the store: those that each application declares, under their names in the store."""
        return tuple(
            [
                replace(v, name=self.stored(index, v.name)) if self.is_composed else v
                for index, application in enumerate(self.applications)
                for v in application.own
            ]
        )

    def access(self) -> tuple[StoreAccess, ...]:
        """Return for each application what it may write."""
        places = {v.name: place for place, v in enumerate(self.shared())}
        found = []
        for index, application in enumerate(self.applications):
            written = [v.name for v in application.own] + [n for each in application.imports for n in each.written]
            indices = {name: places[self.stored(index, name)] for name in written}
            found.append(StoreAccess(application.members, len(application.own), indices, frozenset(application.locks)))
        return tuple(found)

    def constants(self, instance: RobotInstance) -> dict[str, Any]:
        """Return the local variables `Name.pid` of an instance: its robot's pid among an exporter's members, or -1."""
        found = {}
        for each in self.applications[instance.application].imports:
            members = self.applications[each.application].members
            found[f"{each.name}.pid"] = members.index(instance.robot) if instance.robot in members else -1
        return found

    def of(self, robot: int) -> Program:
        """Return a description of all that a robot runs, in the form of one program.

        With one application it is the application's program. With several it has the names of the store, the ports of
        all applications of the robot, and no events. An actuator is declared by one application of the robot.
        """
        if not self.is_composed and robot in self.applications[0].members:
            return self.applications[0].program
        programs = [self.applications[instance.application].program for instance in self.of_robot(robot)]
        ports: dict[str, Port] = {}
        for program in programs:
            for port in program.ports:
                known = ports.get(port.name)
                ports[port.name] = replace(known, is_position=True) if known and port.is_position else known or port
        return Program(
            name=self.name,
            source="",
            program_hash=self.program_hash,
            interface_hash=self.interface_hash,
            locals=tuple([v for program in programs for v in program.locals]),
            shared=self.shared(),
            ports=tuple(ports.values()),
            init=None,
            events=(),
            begin=Transaction,
            file="",
            lines={},
        )


def alone(shared: Sequence[Variable], robots: int) -> tuple[StoreAccess, ...]:
    """Return the access of one application on all robots that declares these variables and may want any lock."""
    return (StoreAccess(tuple(range(robots)), len(shared), {v.name: place for place, v in enumerate(shared)}),)
