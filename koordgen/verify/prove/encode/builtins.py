"""Builtin functions of Koord as SMT terms.

A builtin that the logic can express is replaced by its definition. Every other builtin becomes an uninterpreted
function, and the encoder adds some facts about it.
"""

from __future__ import annotations

from collections.abc import Callable

from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.builtins import UPDATE_SIGNATURES
from koordgen.lang.ir.types import INT, MapOf, Sized
from koordgen.verify.prove.encode.encoder import ExprEncoder
from koordgen.verify.prove.encode.geometry import path_of
from koordgen.verify.prove.encode.quantifier import proxy
from koordgen.verify.prove.encode.values import (
    Collection,
    ConditionalCollection,
    EnumeratedCollection,
    FleetValue,
    UpdatedCollection,
    Val,
    as_term,
    pick,
)
from koordgen.verify.prove.smt import term as t
from koordgen.verify.prove.smt.term import FunctionSymbol, Term

_ZERO, _ONE = t.integer(0), t.integer(1)
_MADE = ("Point", "Pose", "Grid", "Rect", "Ball")
_LISTS = ("sorted", "reversed", "keys", "values", "items", "union", "intersection", "difference")


def builtin(e: ExprEncoder, node: ir.Builtin, args: tuple[Val, ...]) -> Val:
    """Return the value of a builtin function that is applied to `args`, its encoded arguments."""
    name, line = node.name, node.span.line
    if name in _MADE:
        return args
    if name in UPDATE_SIGNATURES and name != "map_at":
        return _updated(e, node, args)
    match name:
        case "distance":
            return e.geometry.distance(*args)
        case "path_distance":
            return e.geometry.path_distance(path_of(args[0]), path_of(args[1]))
        case "clear":
            return _clear(e, args)
        case "abs":
            x = as_term(args[0])
            zero = _ZERO if x.sort is t.INT else t.real(0)
            return t.ite(t.at_most(zero, x), x, t.negate(x))
        case "min" | "max":
            a, b = as_term(args[0]), as_term(args[1])
            return t.ite(t.less(b, a) if name == "min" else t.less(a, b), b, a)
        case "floor" | "ceil" | "round":
            return _whole(name, as_term(args[0]))
        case "sqrt":
            return _root(e, as_term(args[0]), line)
        case "center":
            return _center(args[0])
        case "len":
            return _length(e, node, args[0])
        case "first" | "last":
            xs = path_of(args[0])
            e.context.demand(t.less(_ZERO, e.lists.length(xs)), f"the collection for {name} is not empty", line)
            return _end(e, xs, name == "first")
        case "index":
            e.context.demand(e.lists.has(path_of(args[0]), args[1]), "the item of `index` is in the list", line)
            return e.lists.place(path_of(args[0]), args[1])
        case "sum" if isinstance(args[0], FleetValue):
            zero = _ZERO if node.type is INT else t.real(0)
            return sum_over_robots(e, args[0], "sum", (), as_term, zero)
        case "count" if isinstance(args[0], FleetValue):
            wanted = args[1]
            one = lambda x: t.ite(e.lists.same(x, wanted), _ONE, _ZERO)  # noqa: E731
            return sum_over_robots(e, args[0], "count", e.lists.leaves(wanted), one, _ZERO)
        case "get" | "map_at":
            return _looked_up(e, node, args)
        case _ if name in _LISTS and not isinstance(args[0], FleetValue):
            return UpdatedCollection(name, path_of(args[0]), args[1:], node.type)
        case _:
            return _opaque(e, node, args)


def _end(e: ExprEncoder, xs: Collection, first: bool) -> Val:
    if isinstance(xs, ConditionalCollection):
        return pick(xs.condition, _end(e, xs.then, first), _end(e, xs.orelse, first))
    return e.lists.element(xs, _ZERO if first else t.subtract(e.lists.length(xs), _ONE))


def _opaque(e: ExprEncoder, node: ir.Builtin, args: tuple[Val, ...]) -> Val:
    """Encode a builtin as an uninterpreted function of its arguments.

    # SOUND: the only fact assumed about such a function is that equal arguments give equal results."""
    if node.name in ("asin", "acos", "log"):
        x, one = as_term(args[0]), t.real(1)
        inside = t.less(t.real(0), x) if node.name == "log" else t.and_(t.at_most(t.negate(one), x), t.at_most(x, one))
        e.context.demand(inside, f"the argument of {node.name} is in its domain", node.span.line)
    elif node.name in ("tan", "exp", "cell"):
        e.context.note(f"{node.name}: the proof allows any result, and does not show that a result exists")
    return e.apply(node.name, f"{node.name}@", args, node.type)


def _updated(e: ExprEncoder, node: ir.Builtin, args: tuple[Val, ...]) -> Val:
    xs, line = path_of(args[0]), node.span.line
    context = e.context
    match node.name:
        case "updated" | "without":
            index = as_term(args[1])
            context.demand(t.and_(t.at_most(_ZERO, index), t.less(index, e.lists.length(xs))), "index in range", line)
        case "inserted":
            index = as_term(args[1])
            context.demand(
                t.and_(t.at_most(_ZERO, index), t.at_most(index, e.lists.length(xs))), "index in range", line
            )
        case "popped":
            context.demand(t.less(_ZERO, e.lists.length(xs)), "the popped list is not empty", line)
        case "removed" | "set_without" | "map_without":
            context.demand(e.lists.has(xs, args[1]), "the removed item is present", line)
        case "cleared":
            return EnumeratedCollection((), node.type)
    if isinstance(xs, EnumeratedCollection) and node.name == "appended" and len(xs.items) < 8:
        return EnumeratedCollection((*xs.items, args[1]), node.type)
    return UpdatedCollection(node.name, xs, args[1:], node.type)


def _clear(e: ExprEncoder, args: tuple[Val, ...]) -> Val:
    """Return the term "the path is more than `eps` metres away from each of the other paths"."""
    path, others, eps = path_of(args[0]), path_of(args[1]), as_term(args[2])

    def far(other: Val) -> Term:
        return t.less(eps, e.geometry.path_distance(path, path_of(other)))

    if isinstance(others, EnumeratedCollection):
        return t.all_of([far(other) for other in others.items])
    long = e.lists.length(others)
    return proxy(
        e.context,
        lambda i: t.implies(t.and_(t.at_most(_ZERO, i), t.less(i, long)), far(e.lists.element(others, i))), "other",
        isinstance(others, FleetValue), not isinstance(others, FleetValue),
    )  # fmt: skip


def _whole(name: str, x: Term) -> Term:
    if name == "floor":
        return t.to_int(x)
    if name == "ceil":
        return t.negate(t.to_int(t.negate(x)))
    below = t.to_int(x)  # Python rounds a half to the even neighbour, and the encoding must agree.
    part = t.subtract(x, t.to_real(below))
    half = t.real(0.5)
    even = t.equals(t.remainder(below, t.integer(2)), _ZERO)
    up = t.or_(t.less(half, part), t.and_(t.equals(part, half), t.not_(even)))
    return t.ite(up, t.add(below, _ONE), below)


def _root(e: ExprEncoder, x: Term, line: int) -> Term:
    zero = t.real(0)
    e.context.demand(t.at_most(zero, x), "the argument of sqrt is not negative", line)
    found = t.apply(t.FunctionSymbol("sqrt@", (t.REAL,), t.REAL), x)
    square = t.and_(t.at_most(zero, found), t.equals(t.multiply(found, found), x))
    e.context.fact(t.implies(t.at_most(zero, x), square), "sqrt", line)
    return found


def _center(cell: Val) -> Val:
    assert isinstance(cell, tuple)
    x, y, size = (as_term(part) for part in cell)
    half = t.real(0.5)
    return tuple([t.multiply(t.add(t.to_real(place), half), size) for place in (x, y)] + [t.real(0)])


def _length(e: ExprEncoder, node: ir.Builtin, xs: Val) -> Term:
    if isinstance(node.args[0].type, Sized):
        found = as_term(e.context.function("string.len", (as_term(xs),), INT))
        e.context.fact(t.at_most(_ZERO, found), "a string's length is not negative", node.span.line)
        return found
    return e.lists.length(path_of(xs))


def _looked_up(e: ExprEncoder, node: ir.Builtin, args: tuple[Val, ...]) -> Val:
    xs, key = path_of(args[0]), args[1]
    assert isinstance(node.args[0].type, MapOf)
    held = e.lists.has(xs, key)
    if node.name == "map_at":
        e.context.demand(held, "the map has the key", node.span.line)
        return e.lists.value(xs, key)
    return pick(held, e.lists.value(xs, key), args[2])


# Sums over all robots. After a change of one robot's value, the new sum is the old sum, minus the robot's old value,
# plus the robot's new value.


def sum_over_robots(
    e: ExprEncoder, xs: FleetValue, name: str, extra: tuple[Term, ...], part: Callable[[Val], Term], zero: Term
) -> Term:
    """Return the sum of `part` over all robots.

    If the number of robots is unknown, the sum is an uninterpreted function of all robots' values. These facts are
    known:

    - The sum is zero if all parts are zero. The sum is not negative if no part is negative.
    - The sum is at most N_SYS if no part is above one. The sum is at least N_SYS if no part is below one.
    - For `count`: the sum without one robot's part is at least 0 and below N_SYS."""
    context = e.context
    found: Term = zero
    if context.robots is not None:
        for robot in range(context.robots):
            found = t.add(found, part(xs.slot(t.integer(robot))))
        return found
    if xs.changed is not None:
        before, robot_, value = xs.changed
        rest = t.subtract(sum_over_robots(e, before, name, extra, part, zero), part(before.slot(robot_)))
        found = t.add(rest, part(value))
    else:
        whole = e.lists.term(xs)
        domain = (whole.sort, *[x.sort for x in extra])
        found = t.apply(FunctionSymbol(f"{xs.type}.{name}", domain, zero.sort), whole, *extra)
    if found not in context.folds:
        context.folds.add(found)
        with context.about(f"{name} over all robots", 0):
            _bounded(e, xs, name, part, found)
    return found


def _bounded(e: ExprEncoder, xs: FleetValue, name: str, part: Callable[[Val], Term], found: Term) -> None:
    context, real = e.context, found.sort is t.REAL
    zero, one = (t.real(0), t.real(1)) if real else (t.integer(0), t.integer(1))
    most = t.to_real(context.size) if real else context.size
    wrongs: tuple[tuple[Term, Callable[[Term], Term]], ...] = (
        (t.equals(found, zero), lambda x: t.not_(t.equals(x, zero))),
        (t.at_most(zero, found), lambda x: t.less(x, zero)),
        (t.at_most(found, most), lambda x: t.less(one, x)),
        (t.at_most(most, found), lambda x: t.less(x, one)),
    )
    for holds, wrong in wrongs:
        some = context.new(name, t.INT)
        context.robot(some, witness=True)
        context.fact(t.or_(holds, t.and_(context.within(some), wrong(part(xs.slot(some))))))

    def without(robot: Term) -> Term:
        others = t.subtract(found, part(xs.slot(robot)))
        return t.implies(context.within(robot), t.and_(t.at_most(zero, others), t.less(others, most)))

    if name == "count":
        context.for_all(without)
