"""Random properties and assumptions of a random program."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from random import Random
from typing import Literal

from koordgen.lang.ir import decl as d
from koordgen.lang.ir import expr as e
from koordgen.lang.ir.ports import NO_MEANING
from koordgen.lang.ir.tree import walk
from koordgen.lang.ir.types import BOOL, FLOAT, INT, PLANNER, POINT, PerRobot, Type, list_of
from koordgen.lang.node import replace
from tests.agree.expressions import Expressions
from tests.agree.general import PATH, Maker, Temp, compare
from tests.agree.kinds import AT, whole
from tests.agree.programs import MODULE, N_SYS, random_program


class Formulas(Expressions):
    """Generator for formulas.

    Place "property": over the fleet. Place "assume": over one robot's ports. Place "provided": over shared variables.
    """

    count = 0

    def reads(self, type_: Type) -> list[e.Expr]:
        p = self.program
        found: list[e.Expr] = [e.TempRead(t.name, t.type, AT) for t in self.temps if t.type == type_]
        found *= 3
        found += [e.ParamRead(v.name, v.type, AT) for v in p.params if v.type == type_]
        ports = [
            (m.name, port.name)
            for m in p.modules
            for port in m.ports
            if port.type == type_ and port.direction in ("sensor", "actuator")
        ]
        if type_ == INT:
            found.append(e.NSys(INT, AT))
        if self.place == "assume":
            found += [e.PortRead(*port, primed, type_, AT) for port in ports for primed in (False, True)]
            return [*found, e.Pid(INT, AT)] if type_ == INT else found
        if self.place == "property":
            found += [e.PortOf(*port, self.robot(), type_, AT) for port in ports]
            found += [e.LocalOf(v.name, self.robot(), type_, AT) for v in p.locals if v.type == type_]
        for v in p.shared:
            if v.type == type_ and v.kind == "allread":
                found.append(e.SlotRead(v.name, self.robot(), False, type_, AT))
            elif v.type == type_:
                found.append(e.SharedRead(v.name, type_, AT))
        return found

    def robot(self) -> e.Expr:
        """Return a robot's index, now and then one that no robot has."""
        bound: list[e.Expr] = [e.TempRead(t.name, INT, AT) for t in self.temps if t.type == INT]
        others = [whole(self.rng.randrange(N_SYS)), whole(N_SYS if self.rng.random() < 0.05 else 0)]
        return self.rng.choice([*bound * 3, *others])

    def slots(self, element: Type) -> e.Expr | None:
        shared = [v for v in self.program.shared if v.kind == "allread" and v.type == element]
        if self.place == "assume" or not shared:
            return None
        return e.SlotsRead(self.rng.choice(shared).name, PerRobot(element), AT)

    def special(self, type_: Type) -> list[Maker]:
        found = super().special(type_)
        if type_ == BOOL:
            found = [*found, *[self.quantified] * max(2, len(found) // 2)]
        if type_ == PATH and self.place == "assume":
            found = [*found, self.planned]
        return found

    def quantified(self, n: int) -> e.Expr:
        kind: Literal["forall", "exists"] = self.rng.choice(("forall", "exists"))
        of = self.rng.choice((INT, INT, INT, POINT))
        domain: e.Expr = e.Ids(list_of(INT), AT)
        if of == POINT:
            domain = self.expr(PATH, n)
        elif self.rng.random() < 0.4:
            domain = e.Range(
                whole(self.rng.randrange(2)), e.NSys(INT, AT), self.rng.choice((1, 1, 2)), list_of(INT), AT
            )
        Formulas.count += 1
        name = f"k{Formulas.count}"
        self.temps.append(Temp(name, of, False))
        body = self.expr(BOOL, n)
        self.temps.pop()
        return e.Quantified(kind, name, domain, body, BOOL, AT)

    def planned(self, n: int) -> e.Expr:
        """Return a planner's answer: for any goal, or for one goal."""
        goal: e.Expr = e.TempRead(self.rng.choice(("goal", "other")), POINT, AT)
        return e.PortCall(MODULE, "planner", (goal if self.rng.random() < 0.7 else self.expr(POINT, n),), PATH, AT)


def with_provided(seed: int) -> d.Program:
    """Return a random program that provides a module with a random value for each of its sensors."""
    rng = Random(-seed)
    program = random_program(seed)
    types = [BOOL, INT, FLOAT, POINT, *(v.type for v in program.shared)]
    makers = Formulas(rng, program, "provided")
    values = [_drawn(partial(makers.expr, type_, 4)) for type_ in types]
    values += [_drawn(partial(makers.quantified, 4)) for _ in range(3)]
    ports = [d.Provided(d.Port(f"p{k}", value.type, "sensor", NO_MEANING, AT), value) for k, value in enumerate(values)]
    return replace(program, provides=(d.Provides("Outside", tuple(ports), AT),))


def _drawn(make: Callable[[], e.Expr]) -> e.Expr:
    """Return the first formula in which no quantifier stands twice: an update within a value repeats its place."""
    while True:
        found = make()
        names = [node.name for node in walk(found) if isinstance(node, e.Quantified)]
        if len(names) == len(set(names)):
            return found


def with_formulas(seed: int) -> d.Program:
    """Return a random program with random properties and assumptions."""
    rng = Random(-seed)
    program = random_program(seed)
    formulas = [_drawn(lambda: Formulas(rng, program, "property").quantified(4)) for _ in range(6)]
    properties = [d.Property("invariant", f"P{k}", formula, AT) for k, formula in enumerate(formulas)]
    assumed = [_drawn(lambda: Formulas(rng, program, "assume").expr(BOOL, 4)) for _ in range(3)]
    assumed.append(_ends(rng, program))
    modules = [
        replace(m, assumptions=tuple([d.Assumption(f, AT) for f in assumed])) if m.name == MODULE else m
        for m in program.modules
    ]
    assert any(port.type == PLANNER for m in modules for port in m.ports)
    return replace(program, properties=tuple(properties), modules=tuple(modules))


def _ends(rng: Random, program: d.Program) -> e.Expr:
    """Return a formula over all paths that the planner may return."""
    makers = Formulas(rng, program, "assume")
    way = e.PortCall(MODULE, "planner", (e.TempRead("goal", POINT, AT),), PATH, AT)
    first = e.Builtin("len", (way,), INT, AT)
    return e.Logic("or", compare("<", first, whole(rng.randrange(4))), makers.expr(BOOL, 2), BOOL, AT)
