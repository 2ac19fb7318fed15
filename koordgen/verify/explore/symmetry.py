"""Symmetry reduction: decides whether a program treats all robots alike, and sorts robots.

A program is symmetric if nothing in the program distinguishes one pid from another. Three conditions ensure this:

- `pid` occurs only as the index of the robot's own slot.
- A whole allread variable occurs only where the order of its slots does not matter: in `in`, `count` and `len`, and for
  ints also in `sum`, `min` and `max`.
- A name that a quantifier binds to robots occurs only as an index, or in a comparison of two such names for equality.
  The quantified formula must always have a value.

Then every permutation of the robots turns steps of the program into steps of the program, and changes no property. The
same holds for steps of the environment, whose values are the same for all robots. So one state represents all its
permutations. Any other construct in the program turns the reduction off: the search then visits more states, but its
result is still right.
"""

from __future__ import annotations

from collections.abc import Iterable

from koordgen.lang.ir import decl, expr, stmt
from koordgen.lang.ir.tree import Part, children, walk
from koordgen.lang.ir.types import INT, PerRobot
from koordgen.lang.source import Span
from koordgen.verify.explore.machine import Packed

_UNORDERED = frozenset(("count", "len"))
_OF_INTS = frozenset(("sum", "min", "max"))
_SAFE = frozenset(("Point", "Rect", "Ball", "distance", "abs", "len", "count"))


def asymmetry(program: decl.Program) -> str:
    """Return the place of the first construct in a program that distinguishes robots, as text.

    The text is empty if the program is symmetric."""
    parts = [(p.formula, "a property") for p in program.properties if p.kind != "axiom"]
    parts += [(a.formula, "an assumption") for m in program.modules for a in m.assumptions]
    for part, name in [*parts, *[((e.guard, e.effect), e.name) for e in program.events], (program.init, "init")]:
        span = _apart(part, frozenset())
        if span is not None:
            return f"{name}, line {span.line}"
    return ""


def _apart(node: Part, robots: frozenset[str]) -> Span | None:
    """Return the position of the first construct that distinguishes robots; None without such a construct.

    `robots`: the names that quantifiers bind to robots."""
    match node:
        case tuple():
            return _first_apart(node, robots)
        case expr.Pid(_, span) | expr.Ids(_, span):
            return span
        case expr.SlotsRead(_, _, span):
            return span
        case expr.TempRead(name, _, span):
            return span if name in robots else None
        case expr.SlotRead(_, expr.Pid()):
            return None
        case expr.SlotRead(_, index, _, _, span) | expr.LocalOf(_, index, _, span) | expr.PortOf(_, _, index, _, span):
            return None if isinstance(index, expr.TempRead) and index.name in robots else span
        case expr.Compare("==" | "!=", expr.TempRead(a), expr.TempRead(b)) if a in robots and b in robots:
            return None
        case expr.Quantified(_, name, expr.Ids(), body, _, span):
            return span if _may_fail(body) else _apart(body, robots | {name})
        case expr.Contains(item, expr.SlotsRead()):
            return _apart(item, robots)
        case expr.Builtin(name, (expr.SlotsRead(_, type_), *others)) if _unordered(name, type_):
            return _first_apart(others, robots)
        case stmt.Emit(_, _, items):
            return _first_apart([item for item in items if not _name_of_self(item)], robots)
        case _:
            return _first_apart(children(node), robots)


def _first_apart(parts: Iterable[Part], robots: frozenset[str]) -> Span | None:
    for part in parts:
        found = _apart(part, robots)
        if found is not None:
            return found
    return None


def _may_fail(body: expr.Expr) -> bool:
    """Return whether a formula may have no value.

    The value of a quantifier over such a formula can depend on the order in which the quantifier visits robots."""
    for node in walk(body):
        match node:
            case expr.At() | expr.Slice() | expr.Call() | expr.ExternCall() | expr.PortCall():
                return True
            case expr.Binary("/" | "//" | "%" | "**"):
                return True
            case expr.Builtin(name, args):
                if name not in _SAFE and not isinstance(args[0], expr.SlotsRead):
                    return True
            case _:
                pass
    return False


def _unordered(name: str, type_: object) -> bool:
    ints = isinstance(type_, PerRobot) and type_.element == INT
    return name in _UNORDERED or (name in _OF_INTS and ints)


def _name_of_self(item: expr.Expr) -> bool:
    """Return whether an item that an event writes to a stream is `str(pid)`. No event can read a stream."""
    return isinstance(item, expr.Builtin) and item.name == "str" and isinstance(item.args[0], expr.Pid)


def sorted_robots(fleet: Packed) -> Packed:
    """Return a state with its robots sorted. The result represents all permutations of the robots."""
    n_sys = len(fleet) // 2
    robots = sorted(zip(fleet[:n_sys], fleet[n_sys:-1], strict=True))
    return (*[own for own, _ in robots], *[slots for _, slots in robots], fleet[-1])
