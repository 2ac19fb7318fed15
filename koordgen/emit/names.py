"""Mints every Python name in a generated program: pure, collision-checked, prefixed.

A prefix keeps a Koord name clear of Python's keywords and builtins (a variable called `class` becomes
`local_class`) and says on a robot at night what a name is.
"""

from __future__ import annotations

import re

from koordgen.ir.decl import Program

_WORD = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")


def snake(name: str) -> str:
    """`TargetUpdate` -> `target_update`; anything that is no letter, digit or underscore goes."""
    return re.sub(r"\W", "", _WORD.sub("_", name)).lower()


class Names:
    """The Python name of each thing in one program. The first thing to claim a name gets it, later ones a number."""

    def __init__(self, program: Program) -> None:
        self._taken: set[str] = set()
        self.params = {p.name: self._mint(f"PARAM_{snake(p.name).upper()}") for p in program.params}
        self.locals = {v.name: self._mint(f"local_{v.name}") for v in program.locals}
        self.shared = {v.name: self._mint(f"shared_{v.name}") for v in program.shared}
        self.ports = {
            (m.name, p.name): self._mint(f"{snake(m.name)}_{p.name}") for m in program.modules for p in m.ports
        }
        self.sensors = {(m.name, p.name) for m in program.modules for p in m.ports if p.direction == "sensor"}
        self.guards = {e.name: self._mint(f"guard_{snake(e.name)}") for e in program.events}
        self.effects = {e.name: self._mint(f"effect_{snake(e.name)}") for e in program.events}

    def _mint(self, wanted: str) -> str:
        name, number = wanted, 2
        while name in self._taken:
            name, number = f"{wanted}_{number}", number + 1
        self._taken.add(name)
        return name

    @staticmethod
    def temp(name: str) -> str:
        """A variable declared inside an event: unique there already, and no other name starts so."""
        return f"my_{name}"
