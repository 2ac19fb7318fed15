"""Invariants of a program, compiled to Python functions and evaluated on packed states of a fleet."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from koordgen.build.emit import expr, library
from koordgen.lang.ir import decl
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.tree import walk
from koordgen.runtime.program.property import Each, One
from koordgen.runtime.values.turns import begin
from koordgen.verify.explore.machine import Interned, Machine, Packed
from koordgen.verify.explore.pairs import PairInvariants, pair_formula


class _Fleet:
    """Argument of compiled formulas: one attribute for each variable and port of the program.

    `Names` of the code emitter chooses the names of the attributes."""

    def __init__(self, n_sys: int) -> None:
        self.n_sys = n_sys


class _View:
    """View of a formula: the part of a fleet's state that the formula reads, as numbers.

    The formula has equal truth values on equal views, so `known` stores the truth value of each view."""

    def __init__(self, formula: ir.Expr, machine: Machine) -> None:
        names = _reads(formula)
        self._machine = machine
        self._own = [v.name for v in machine.program.locals if v.name in names]
        self._ports = [name for name in (*machine.sensors, *machine.actuators) if name in names]
        self._slots = [i for i, name in enumerate(machine.allread) if name in names]
        self._cells = [i for i, name in enumerate(machine.allwrite) if name in names]
        self._parts: Interned[None] = Interned()
        self._of: tuple[dict[int, int], dict[int, int], dict[int, int]] = ({}, {}, {})
        self.known: dict[Packed, bool] = {}

    def of(self, fleet: Packed) -> Packed:
        """Return the view of a fleet's state.

        Each number in the state stands for several values. The view numbers only the values that the formula reads."""
        n_sys = self._machine.n_sys
        owns, slots, cells = self._of
        try:
            return (
                *[owns[number] for number in fleet[:n_sys]],
                *[slots[number] for number in fleet[n_sys:-1]],
                cells[fleet[-1]],
            )
        except KeyError:
            self._learn(fleet)
            return self.of(fleet)

    def _learn(self, fleet: Packed) -> None:
        machine, n_sys = self._machine, self._machine.n_sys
        owns, slots, cells = self._of
        for number in fleet[:n_sys]:
            robot = machine.owns.values[number]
            ports = {**robot.sensors, **robot.actuators}
            held = [(name, robot.locals[name]) for name in self._own] + [(name, ports[name]) for name in self._ports]
            owns[number] = self._part(held)
        for number in fleet[n_sys:-1]:
            values = machine.slots.values[number]
            slots[number] = self._part([(machine.allread[i], values[i]) for i in self._slots])
        written = machine.cells.values[fleet[-1]]
        cells[fleet[-1]] = self._part([(machine.allwrite[i], written[i]) for i in self._cells])

    def _part(self, held: list[tuple[str, Any]]) -> int:
        return self._parts.number(tuple([self._machine.key(name, value) for name, value in held]), None)


class Invariants:
    """Compiled invariants of one program.

    `unchecked`: names of the invariants that call a `spec fun`. Such a function cannot be evaluated."""

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        specs = {s.name for s in machine.program.specs}
        meant: dict[bool, list[decl.Property]] = {True: [], False: []}
        for property_ in machine.program.properties:
            if property_.kind == "invariant":
                meant[not calls_spec(property_.formula, specs)].append(property_)
        self.properties, self.unchecked = tuple(meant[True]), tuple([p.name for p in meant[False]])
        spreads = [pair_formula(property_.formula) for property_ in self.properties]
        self._holds = [self._compiled(property_) for property_ in self.properties]
        self._whole = [
            (_View(property_.formula, machine), holds)
            for property_, holds, one in zip(self.properties, self._holds, spreads, strict=True)
            if one is None
        ]
        self._fleet = _Fleet(machine.n_sys)
        self._pairs = PairInvariants(machine, [one for one in spreads if one], self._fleet, self._load)
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
        """Return the first invariant that is false or has no value in a state; None if all are true."""
        if self._pairs.hold(fleet) and self._whole_hold(fleet):
            return None
        self._load(fleet)
        return next(p for p, holds in zip(self.properties, self._holds, strict=True) if not self._true(holds))

    def _whole_hold(self, fleet: Packed) -> bool:
        """Return whether the invariants hold that are not evaluated by `PairInvariants`."""
        taken = False
        for view, holds in self._whole:
            seen = view.of(fleet)
            held = view.known.get(seen)
            if held is None:
                if not taken:
                    self._load(fleet)
                    taken = True
                held = view.known[seen] = self._true(holds)
            if not held:
                return False
        return True

    def _true(self, holds: Callable[[_Fleet], bool]) -> bool:
        begin()
        try:
            return holds(self._fleet)
        except Exception:  # an extern function is code of the user and may raise any exception
            return False

    def _load(self, fleet: Packed) -> None:
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
        imports = "\n".join([line for group in library.imports(self.machine.names.used) for line in group])
        scope = dict(self.machine.scope)
        exec(compile(f"{imports}\n{body}", f"invariant {property_.name}", "exec"), scope)
        found: Callable[[_Fleet], bool] = scope["invariant"]
        return found


def calls_spec(formula: ir.Expr, specs: set[str]) -> bool:
    """Return whether a formula calls one of the functions `specs`."""
    return any(isinstance(node, ir.Call) and node.name in specs for node in walk(formula))


def _reads(formula: ir.Expr) -> set[str]:
    """Return the names of the local variables, shared variables and ports that a formula reads."""
    found = set()
    for node in walk(formula):
        match node:
            case ir.LocalOf(name) | ir.SlotRead(name) | ir.SlotsRead(name) | ir.SharedRead(name):
                found.add(name)
            case ir.PortOf(module, port):
                found.add(f"{module}.{port}")
            case _:
                pass
    return found
