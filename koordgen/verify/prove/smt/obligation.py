"""What is to be shown, as data: facts, a goal, and which terms are which variables of the program.

`obligations` of generate.py makes them; others print, solve and explain them.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

from koordgen.lang.ir.types import Type
from koordgen.lang.node import Node
from koordgen.verify.prove.smt.term import Term

Kind = Literal["base", "event", "environment", "loop", "well-defined", "consistency"]
Moment = Literal["round start", "before", "after"]


class Fact(Node):
    """A formula and where it comes from: its label says what it is ("invariant Geofence", "guard of Assign"), `file`
    and `line` where the program says so. `position`: how many loop heads and loop ends stand before the place of the
    event at which the formula is known; a goal uses only facts whose position is at most its own."""

    label: str
    term: Term
    file: str
    line: int
    position: int = 0


class Cell(Node):
    """One variable of the program at one moment: `terms` are its value's parts, in the order in which parts.py
    flattens its type. `robot`: whose it is, a term of sort Int; None of an allwrite variable. `name` as the program
    writes it: "x", "leader", "Motion.position"; params are cells, too."""

    name: str
    robot: Term | None
    type: Type
    terms: tuple[Term, ...]
    moment: Moment


class AtHead(NamedTuple):
    """One formula that is assumed at one loop's head: the `number`-th loop of `owner` (an event, `init` or a function).
    `invariant` names it: an invariant of the program, or the line of one that stands at the loop."""

    owner: str
    number: int
    invariant: str


class Obligation(Node):
    """The facts imply the goal, where `expected` is "unsat" (of the facts and the goal's negation); a consistency
    obligation has no goal and its facts are satisfiable. `invariant` is its name ("(well-defined)" for that one);
    `event` the event's or "init", "(environment)", "" where there is none. `conjuncts`: the goal in parts, so that a
    counterexample can tell which of them fails. `robots`: None for every N_SYS. `notes`: each approximation that was
    made, and what is assumed without being in the program. `at`: of kind "loop", the head of a loop and what is assumed
    there. `unwritten`: the reason why its formulas were not written down, where they are too large: no solver is asked,
    and the answer is "unknown"."""

    name: str
    kind: Kind
    invariant: str
    event: str
    file: str
    line: int
    logic: str
    facts: tuple[Fact, ...]
    goal: Fact | None
    expected: Literal["unsat", "sat"]
    conjuncts: tuple[Fact, ...]
    cells: tuple[Cell, ...]
    robots: int | None
    notes: tuple[str, ...]
    at: AtHead | None = None
    unwritten: str = ""
