"""Guarantees of exported variables, compiled to Python functions and evaluated on packed states.

A state guarantee must hold in every state, a step guarantee at every change of its variable, between the values just
before and just after the step. A step that leaves the variable as it is keeps the guarantee, because step guarantees
are reflexive.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from koordgen.build.emit import expr, library
from koordgen.lang.ir import decl
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.tree import transform, walk
from koordgen.lang.node import Node, replace
from koordgen.runtime.values.turns import begin
from koordgen.verify.explore.invariants import calls_spec
from koordgen.verify.explore.machine import Machine, Packed


class _Guarantee(NamedTuple):
    """Guarantee of an exported variable. `holds`: function of the variable's values before and after a write."""

    guarantee: decl.Guarantee
    variable: str
    holds: Callable[[Any, Any], bool]


class _Fleet(NamedTuple):
    n_sys: int


class Guarantees:
    """Guarantees of one program's exported variables. Packed states are those of the program's machine.

    `has_steps`: whether there is a step guarantee.
    `ordered`: the variables with a step guarantee.
    `unchecked`: names of the guarantees that call a `spec fun`. Such a function cannot be evaluated."""

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        specs = {s.name for s in machine.program.specs}
        given = [(export.variable, g) for export in machine.program.exports for g in export.guarantees]
        self.unchecked = tuple([g.name for _, g in given if calls_spec(g.formula, specs)])
        kept = [_Guarantee(g, v, self._compiled(g)) for v, g in given if not calls_spec(g.formula, specs)]
        self.states = [each for each in kept if not decl.is_step(each.guarantee)]
        self.steps = [each for each in kept if decl.is_step(each.guarantee)]
        self.ordered = frozenset([each.variable for each in self.steps])
        self._known: dict[tuple[Packed, Packed], decl.Guarantee | None] = {}

    def broken(self, view: Packed) -> decl.Guarantee | None:
        """Return the first state guarantee that is false or has no value in a state; None if all are true."""
        for guarantee, variable, holds in self.states:
            value = self._value(view, variable)
            if not _true(holds, value, value):
                return guarantee
        return None

    def broken_step(self, before: Packed, after: Packed) -> decl.Guarantee | None:
        """Return the first step guarantee that is false or has no value at a step; None if all are true."""
        n_sys = self.machine.n_sys
        key = (before[n_sys:], after[n_sys:])
        if key[0] == key[1]:
            return None
        if key not in self._known:
            self._known[key] = self._broken_step(before, after)
        return self._known[key]

    def _broken_step(self, before: Packed, after: Packed) -> decl.Guarantee | None:
        for guarantee, variable, holds in self.steps:
            old, new = self._value(before, variable), self._value(after, variable)
            if self._key(variable, old) != self._key(variable, new) and not _true(holds, old, new):
                return guarantee
        return None

    def _key(self, variable: str, value: Any) -> Any:
        if variable in self.machine.allwrite:
            return self.machine.key(variable, value)
        return [self.machine.key(variable, each) for each in value]

    def _value(self, view: Packed, variable: str) -> Any:
        machine = self.machine
        if variable in machine.allwrite:
            return machine.cells.values[view[-1]][machine.allwrite.index(variable)]
        place = machine.allread.index(variable)
        return tuple([machine.slots.values[number][place] for number in view[machine.n_sys : -1]])

    def _compiled(self, guarantee: decl.Guarantee) -> Callable[[Any, Any], bool]:
        names, formula, after = self.machine.names, *_with_python_name(guarantee)
        values = f"{names.temp(guarantee.before)}, {names.temp(after)}"
        body = f"def guarantee(s, {values}):\n    return {expr.text(formula, names)}\n"
        imports = "\n".join([line for group in library.imports(names.used) for line in group])
        scope = dict(self.machine.scope)
        exec(compile(f"{imports}\n{body}", f"guarantee {guarantee.name}", "exec"), scope)
        found: Callable[..., bool] = scope["guarantee"]
        fleet = _Fleet(self.machine.n_sys)
        return lambda before, after: found(fleet, before, after)


def _with_python_name(guarantee: decl.Guarantee) -> tuple[ir.Expr, str]:
    """Return the formula with another name for the value after a write, which has a prime, and this name."""
    taken = {getattr(node, "name", "") for node in walk(guarantee.formula)}
    after = f"{guarantee.before}_after"
    while after in taken:
        after += "_"

    def renamed(node: Any) -> Node:
        if isinstance(node, ir.TempRead) and node.name == guarantee.after:
            return replace(node, name=after)
        found: Node = node
        return found

    formula: Any = transform(guarantee.formula, renamed)
    return formula, after


def _true(holds: Callable[[Any, Any], bool], before: Any, after: Any) -> bool:
    begin()
    try:
        return holds(before, after)
    except Exception:  # an extern function is code of the user and may raise any exception
        return False
