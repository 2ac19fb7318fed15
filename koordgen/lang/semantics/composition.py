"""Composition of a fleet: applications with their members, and the bindings of their imports.

An *instance* is an application at work on one robot. Instances are numbered application by application, and within an
application by pid. With one application on all robots the number of an instance is its pid.
"""

from __future__ import annotations

from koordgen.lang.ir.decl import Import, Program, Shared, own_shared
from koordgen.lang.node import Node


class Application(Node):
    """Application of a fleet.

    `members`: the robots that run the program, by their places in the fleet file, ascending; a robot's pid in this
    application is its index here. `bindings`: name of each import of the program -> name of the exporting application.
    """

    name: str
    program: Program
    members: tuple[int, ...]
    bindings: tuple[tuple[str, str], ...] = ()


class Instance(Node):
    """Instance of an application: its application's index, its pid there, and its robot's place in the fleet file."""

    application: int
    pid: int
    robot: int


class System(Node):
    """All applications of a fleet of `robots` robots, in the order of the fleet file.

    Every import is bound to an application that exports the variable with an equal type, and no imports form a cycle.
    """

    applications: tuple[Application, ...]
    robots: int

    @classmethod
    def alone(cls, program: Program, robots: int) -> System:
        """Return the system of a fleet whose robots all run one program."""
        return cls((Application(program.name, program, tuple(range(robots))),), robots)

    def instances(self) -> tuple[Instance, ...]:
        """Return all instances by their numbers."""
        return tuple(
            Instance(index, pid, robot)
            for index, application in enumerate(self.applications)
            for pid, robot in enumerate(application.members)
        )

    def index(self, name: str) -> int:
        """Return the index of an application. Raises StopIteration if there is none of that name."""
        return next(index for index, each in enumerate(self.applications) if each.name == name)

    def exporter(self, application: int, imported: Import) -> int:
        """Return the index of the application to which an import is bound."""
        return self.index(dict(self.applications[application].bindings)[imported.name])

    def owner(self, application: int, variable: str) -> int:
        """Return the index of the application that declares a shared variable, which `application` may import."""
        for imported in self.applications[application].program.imports:
            if variable in imported.variables:
                return self.exporter(application, imported)
        return application

    def own(self, application: int) -> tuple[Shared, ...]:
        """Return the shared variables that an application itself declares."""
        return tuple(own_shared(self.applications[application].program))

    def locks(self) -> dict[tuple[int, int], int]:
        """Return the lock of the system for each lock of each application: (application, its lock) -> lock.

        A lock of the system protects a connected set of variables: variables that occur in one atomic event of some
        application are in the same set, even if several applications use them.
        """
        leader: dict[tuple[int, str], tuple[int, str]] = {}

        def top(variable: tuple[int, str]) -> tuple[int, str]:
            while leader.setdefault(variable, variable) != variable:
                variable = leader[variable]
            return variable

        groups: dict[tuple[int, int], list[tuple[int, str]]] = {}
        for index, application in enumerate(self.applications):
            for lock, names in enumerate(application.program.locks):
                groups[index, lock] = [(self.owner(index, name), name) for name in names]
                for variable in groups[index, lock][1:]:
                    leader[top(variable)] = top(groups[index, lock][0])
        numbers: dict[tuple[int, str], int] = {}
        return {key: numbers.setdefault(top(group[0]), len(numbers)) for key, group in groups.items()}
