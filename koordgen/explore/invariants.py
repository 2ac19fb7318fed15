"""A program's invariants as compiled Python over packed fleets."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from koordgen.emit import expr, library
from koordgen.explore.machine import Machine, Packed
from koordgen.ir import decl
from koordgen.ir import expr as ir
from koordgen.node import nodes
from koordgen.runtime.property import Each, One


class _Fleet:
    """What a formula reads; its names are minted for the program."""

    def __init__(self, n_sys: int) -> None:
        self.n_sys = n_sys


class Invariants:
    """All that can be evaluated; `unchecked` are the names of those that ask a `spec fun`."""

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        specs = {s.name for s in machine.program.specs}
        meant: dict[bool, list[decl.Property]] = {True: [], False: []}
        for property_ in machine.program.properties:
            if property_.kind == "invariant":
                meant[not _calls(property_.formula, specs)].append(property_)
        self.properties, self.unchecked = tuple(meant[True]), tuple([p.name for p in meant[False]])
        self._holds = [self._compiled(property_) for property_ in self.properties]
        self._fleet = _Fleet(machine.n_sys)
        names, program = machine.names, machine.program
        self._each: dict[str, Each[Any]] = {}
        self._one: dict[str, One[Any]] = {}
        attributes = {v.name: names.locals[v.name] for v in program.locals}
        attributes |= {name: names.shared[name] for name in machine.allread}
        attributes |= {f"{m.name}.{p.name}": names.ports[m.name, p.name] for m in program.modules for p in m.ports}
        for name, attribute in attributes.items():
            self._each[name] = Each(name, None)
            setattr(self._fleet, attribute, self._each[name])
        for name in machine.allwrite:
            self._one[name] = One(name, None)
            setattr(self._fleet, names.shared[name], self._one[name])

    def broken(self, fleet: Packed) -> decl.Property | None:
        """The first that does not hold; one that has no value (an index that names no robot) does not."""
        self._take(fleet)
        for property_, holds in zip(self.properties, self._holds, strict=True):
            try:
                if holds(self._fleet):
                    continue
            except Exception:  # whatever functions of the user's raise
                return property_
            return property_
        return None

    def _take(self, fleet: Packed) -> None:
        machine = self.machine
        robots = [machine.owns.values[own] for own in fleet[: machine.n_sys]]
        for v in machine.program.locals:
            self._each[v.name].values = [robot.locals[v.name] for robot in robots]
        for name in machine.sensors:
            self._each[name].values = [robot.sensors[name] for robot in robots]
        for name in machine.actuators:
            self._each[name].values = [robot.actuators[name] for robot in robots]
        columns = zip(*[machine.slots.values[number] for number in fleet[machine.n_sys : -1]], strict=True)
        for name, column in zip(machine.allread, columns, strict=False):
            self._each[name].values = column
        for name, value in zip(machine.allwrite, machine.cells.values[fleet[-1]], strict=True):
            self._one[name].content = value

    def _compiled(self, property_: decl.Property) -> Callable[[_Fleet], bool]:
        body = f"def invariant(s):\n    return {expr.text(property_.formula, self.machine.names)}\n"
        imports = "\n".join([line for group in library.imports(body) for line in group])
        scope = dict(self.machine.scope)
        exec(compile(f"{imports}\n{body}", f"invariant {property_.name}", "exec"), scope)
        found: Callable[[_Fleet], bool] = scope["invariant"]
        return found


def _calls(formula: ir.Expr, specs: set[str]) -> bool:
    return any(isinstance(node, ir.Call) and node.name in specs for node in nodes(formula))
