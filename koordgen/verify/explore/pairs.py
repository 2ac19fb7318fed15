"""Invariants about one robot or a pair of robots, evaluated once for each robot and each pair.

Such an invariant has the form `forall i in ID: ...` or `forall i, j in ID: ...`, and its formula reads no other robot.
It holds in a fleet if the formula is true for each robot and each pair. All these invariants are evaluated together.
The result is stored under a key: the private states and slots of the robot or pair, and the allwrite variables.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from koordgen.build.emit import expr, library
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.tree import walk
from koordgen.runtime.values.turns import begin
from koordgen.verify.explore.machine import Machine, Packed


class PairFormula(NamedTuple):
    """A formula about one robot or a pair of robots.

    `names`: the one or two names that the quantifiers bind.
    `body`: the formula inside the quantifiers.
    `numbers`: whether the formula uses the robots' pids as numbers, not only as indices."""

    names: tuple[str, ...]
    body: ir.Expr
    numbers: bool


def pair_formula(formula: ir.Expr) -> PairFormula | None:
    """Return the names and the body of a formula about one robot or a pair; None for any other formula."""
    names, body = [], formula
    while isinstance(body, ir.Quantified) and body.kind == "forall" and isinstance(body.domain, ir.Ids):
        names.append(body.name)
        body = body.body
    if not 1 <= len(names) <= 2:
        return None
    numbers, indices = 0, 0
    for node in walk(body):
        match node:
            case ir.LocalOf(_, ir.TempRead(at)) | ir.SlotRead(_, ir.TempRead(at)) | ir.PortOf(_, _, ir.TempRead(at)):
                if at not in names:
                    return None
                indices += 1
            case ir.Compare("==" | "!=", ir.TempRead(a), ir.TempRead(b)) if a in names and b in names:
                indices += 2
            case (
                ir.LocalOf() | ir.SlotRead() | ir.PortOf() | ir.SlotsRead() | ir.Ids() | ir.PortCall() | ir.ExternCall()
            ):
                return None
            case ir.TempRead(name) if name in names:
                numbers += 1
            case _:
                pass
    return PairFormula(tuple(names), body, numbers > indices)


class PairInvariants:
    """Invariants of one program about single robots and pairs of robots, compiled to Python functions.

    `fleet`: the argument of the compiled functions.
    `load`: function that stores the values of a fleet's state in `fleet`."""

    def __init__(
        self, machine: Machine, formulas: Sequence[PairFormula], fleet: object, load: Callable[[Packed], None]
    ) -> None:
        self._fleet, self._load = fleet, load
        self._numbers = any(f.numbers for f in formulas)
        self._one = [_compiled(f, machine) for f in formulas if len(f.names) == 1]
        self._two = [_compiled(f, machine) for f in formulas if len(f.names) == 2]
        self._n_sys = machine.n_sys
        self._known: dict[Packed, bool] = {}

    def hold(self, fleet: Packed) -> bool:
        """Return whether all invariants of this object hold in a state of the fleet."""
        if not self._one and not self._two:
            return True
        n_sys, known, cells = self._n_sys, self._known, fleet[-1]
        pids = range(n_sys) if self._numbers else [0] * n_sys
        robots = list(zip(fleet[:n_sys], fleet[n_sys:-1], pids, strict=True))
        key: Packed
        for i, robot in enumerate(robots):
            key = (*robot, cells)
            if (true := known.get(key)) is None:
                true = known[key] = self._true(fleet, i, i)
            if not true:
                return False
        if self._two:
            for i, robot in enumerate(robots):
                for j, other in enumerate(robots):
                    if i != j:
                        key = (*robot, *other, cells)
                        if (true := known.get(key)) is None:
                            true = known[key] = self._true(fleet, i, j)
                        if not true:
                            return False
        return True

    def _true(self, fleet: Packed, i: int, j: int) -> bool:
        self._load(fleet)
        begin()
        try:
            return (i != j or all(holds(self._fleet, i) for holds in self._one)) and all(
                holds(self._fleet, i, j) for holds in self._two
            )
        except Exception:  # an extern function is code of the user and may raise any exception
            return False


def _compiled(formula: PairFormula, machine: Machine) -> Callable[..., bool]:
    names = ", ".join([machine.names.temp(name) for name in formula.names])
    body = f"def invariant(s, {names}):\n    return {expr.text(formula.body, machine.names)}\n"
    imports = "\n".join([line for group in library.imports(machine.names.used) for line in group])
    scope = dict(machine.scope)
    exec(compile(f"{imports}\n{body}", "invariants of pairs", "exec"), scope)
    found: Callable[..., bool] = scope["invariant"]
    return found
