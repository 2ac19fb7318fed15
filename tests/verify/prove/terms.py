"""Small hand-made obligations with known answers."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

from koordgen.lang.ir.types import INT as KOORD_INT
from koordgen.verify.prove.smt.obligation import LabelledFormula, Obligation, StateCell
from koordgen.verify.prove.smt.term import (
    INT,
    REAL,
    FunctionSymbol,
    Term,
    add,
    apply,
    constant,
    integer,
    less,
    multiply,
    real,
)

ROBOT = constant("i", INT)
X = FunctionSymbol("Motion.position.x", (INT,), REAL)


def x(index: Term) -> Term:
    return apply(X, index)


def obligation(facts: dict[str, Term], goal: Term | None, **more: Any) -> Obligation:
    """Of these facts by their labels, each on a line of its own from 1 on."""
    listed = tuple(
        [LabelledFormula(label, fact, "app.koord", line) for line, (label, fact) in enumerate(facts.items(), 1)]
    )
    shown = LabelledFormula("invariant Bounded", goal, "app.koord", 9) if goal else None
    fields = {
        "name": "Bounded-Go", "kind": "event", "invariant": "Bounded", "event": "Go", "file": "app.koord", "line": 9,
        "logic": "QF_UFLIRA", "facts": listed, "goal": shown, "expected": "unsat" if goal else "sat", "conjuncts": (),
        "cells": (), "robots": None, "notes": (),
    }  # fmt: skip
    return Obligation(**{**fields, **more})


def true_one(**more: Any) -> Obligation:
    """x(i) < 1/3 implies x(i) < 1/2."""
    return obligation(
        {"guard of Go": less(x(ROBOT), real(Fraction(1, 3)))}, less(x(ROBOT), real(Fraction(1, 2))), **more
    )


def false_one(**more: Any) -> Obligation:
    """x(i) < 1/2 does not imply x(i) < 1/3."""
    cell = StateCell("count", ROBOT, KOORD_INT, (x(ROBOT),), "before")
    facts = {"guard of Go": less(x(ROBOT), real(Fraction(1, 2)))}
    return obligation(facts, less(x(ROBOT), real(Fraction(1, 3))), cells=(cell,), **more)


def contradictory() -> Obligation:
    """Of three facts the first and the last cannot both hold."""
    facts = {
        "assume low": less(x(ROBOT), real(0)),
        "initially": less(integer(0), ROBOT),
        "assume high": less(real(1), x(ROBOT)),
    }
    return obligation(facts, None, kind="consistency", name="consistency", invariant="", event="")


def hard() -> Obligation:
    """A cube that is a sum of cubes: nothing that a solver decides in a moment."""
    a, b, c = (constant(name, INT) for name in "abc")

    def cube(t: Term) -> Term:
        return multiply(multiply(t, t), t)

    facts = {f"{t.function.name} is large": less(integer(1), t) for t in (a, b, c)}  # type: ignore[union-attr]
    return obligation({**facts, "sum": less(cube(c), add(add(cube(a), cube(b)), integer(1)))},
                      less(cube(c), add(cube(a), cube(b))), logic="QF_NIA")  # fmt: skip
