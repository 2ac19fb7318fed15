"""Proof obligations as data: facts, a goal, and the terms of the program's variables.

The package `obligations` creates obligations. Other modules print, solve and explain them.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

from koordgen.lang.ir.types import Type
from koordgen.lang.node import Node
from koordgen.verify.prove.smt.term import Term

Kind = Literal["base", "event", "environment", "loop", "well-defined", "consistency", "interference", "guarantee"]
# Kinds of the obligations that an application has only because of its exports and imports.
OF_INTERFACE: frozenset[Kind] = frozenset(("interference", "guarantee"))
StateName = Literal["round start", "before", "after"]


class LabelledFormula(Node):
    """Formula with its origin.

    `label`: describes the formula ("invariant Geofence", "guard of Assign").
    `file`, `line`: the formula's position in the program.
    `position`: the number of loop heads and loop ends in the event before the program point at which the formula
        becomes known. A goal uses only facts whose position is at most the goal's position."""

    label: str
    term: Term
    file: str
    line: int
    position: int = 0


class StateCell(Node):
    """Variable of the program in one state.

    `name`: the variable as the program writes it: "x", "leader", "Motion.position". A param is also a variable.
    `robot`: the robot that owns the variable, as a term of sort Int; None for an allwrite variable or a param.
    `terms`: the parts of the variable's value, in the order of `shape` in encode/values.py."""

    name: str
    robot: Term | None
    type: Type
    terms: tuple[Term, ...]
    state_name: StateName


class HeadFormula(NamedTuple):
    """Formula that is assumed at the head of a loop.

    `owner`: the event, `init` or function that contains the loop.
    `number`: the number of the loop in its owner.
    `invariant`: the name of an invariant of the program, or the line of an invariant that the program states at the
    loop."""

    owner: str
    number: int
    invariant: str


class Obligation(Node):
    """Claim that a solver must confirm.

    If `expected` is "unsat", the claim is that the facts imply the goal: the facts and the goal's negation are
    unsatisfiable. A consistency obligation has no goal. Its claim is that its facts are satisfiable.

    `invariant`: the invariant's name, "(well-defined)" or, for a guarantee, "guarantee mapping.Kept".
    `event`: the event's name, "init", "(environment)" or "". With several applications also "(first values)",
        "(other applications)", "(commands from outside)", "(reflexive)" and "(transitive)".
    `conjuncts`: the goal as conjuncts, so that a counterexample can show the conjunct that fails.
    `robots`: the number of robots; None for any number.
    `notes`: each approximation in the encoding, and each assumption that is not in the program.
    `at`: for kind "loop", the loop head and its formula.
    `too_large`: if the formulas exceed a limit, the reason why they were not encoded. In this case no solver is asked,
        and the answer is "unknown"."""

    name: str
    kind: Kind
    invariant: str
    event: str
    file: str
    line: int
    logic: str
    facts: tuple[LabelledFormula, ...]
    goal: LabelledFormula | None
    expected: Literal["unsat", "sat"]
    conjuncts: tuple[LabelledFormula, ...]
    cells: tuple[StateCell, ...]
    robots: int | None
    notes: tuple[str, ...]
    at: HeadFormula | None = None
    too_large: str = ""
