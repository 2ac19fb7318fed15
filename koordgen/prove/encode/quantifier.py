"""Quantifiers, and what loops run over."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from koordgen.ir import expr as ir
from koordgen.ir.types import MapOf, Sequence, Type
from koordgen.prove import term as t
from koordgen.prove.encode.geometry import path_of
from koordgen.prove.encode.room import Room
from koordgen.prove.encode.values import Fleet, Known, Val
from koordgen.prove.term import Term

if TYPE_CHECKING:
    from koordgen.prove.encode.expr import Encoder, Scope

_ZERO, _ONE = t.integer(0), t.integer(1)
_EXPANDED = 8  # a domain of at most so many elements is gone through one by one


class Domain(NamedTuple):
    """`inside`: whether an int is a place in it; `element`: what is there; `few`: all elements, where they are few.
    `robots`, `places`: what its places are."""

    inside: Callable[[Term], Term]
    element: Callable[[Term], Val]
    few: list[Val] | None
    robots: bool
    places: bool


def quantified(e: Encoder, node: ir.Quantified, scope: Scope) -> Val:
    """As a truth value of its own, which every instance that is looked at agrees with."""
    every = node.kind == "forall"
    over = domain(e, node.domain, scope)
    temps = dict(scope.temps)

    def holds(element: Val) -> Term:
        kept, scope.temps = scope.temps, {**temps, node.name: element}
        try:
            return e.defined(node.body, scope)
        finally:
            scope.temps = kept

    if over.few is not None:
        parts = [holds(element) for element in over.few]
        return t.all_of(parts) if every else t.any_of(parts)

    def instance(index: Term) -> Term:
        held = holds(over.element(index))
        return t.implies(over.inside(index), held if every else t.not_(held))

    found = proxy(e.room, instance, node.name, over.robots, over.places)
    return found if every else t.not_(found)


def proxy(room: Room, instance: Callable[[Term], Term], name: str, robots: bool = True, places: bool = False) -> Term:
    """A truth value: whether every instance holds."""
    some = room.new(name, t.INT)
    first = instance(some)
    found = room.new(f"forall {name}", t.BOOL)
    room.element(some, robots, places)
    room.fact(t.or_(found, t.not_(first)), "one of which it does not hold")
    room.for_all(lambda index: t.implies(found, instance(index)), robots, places)
    return found


def in_fleet(e: Encoder, xs: Fleet, item: Val) -> Term:
    """Whether a robot has that."""
    room = e.room
    key = (xs.name, *e.lists.leaves(item))
    if key not in room.nowhere:
        room.nowhere[key] = proxy(
            room, lambda index: t.implies(room.within(index), t.not_(e.lists.same(xs.slot(index), item))), "robot"
        )
    return t.not_(room.nowhere[key])


def domain(e: Encoder, node: ir.Expr, scope: Scope) -> Domain:
    """What a quantifier or a loop runs over."""
    if isinstance(node, ir.Range):
        return _range(e, node, scope)
    xs = path_of(e.value(node, scope))
    if isinstance(xs, Known) and len(xs.items) <= _EXPANDED and (len(xs.items) < 2 or not _unordered(node.type)):
        return Domain(_never, _int, [_key(item, node.type) for item in xs.items], False, False)
    room, long, fleet = e.room, e.lists.length(xs), isinstance(xs, Fleet)

    def inside(index: Term) -> Term:
        if fleet and room.indices.get(index, False):
            return t.TRUE
        return t.and_(t.at_most(_ZERO, index), t.less(index, long))

    return Domain(inside, lambda i: _key(e.lists.element(xs, i), node.type), None, fleet, not fleet)


def _range(e: Encoder, node: ir.Range, scope: Scope) -> Domain:
    start, stop = e.term(node.start, scope), e.term(node.stop, scope)
    low, high = t.number(start), t.number(stop)
    if stop is e.room.size and e.room.robots is None:
        high = None  # robots are not gone through one by one
    if low is not None and high is not None and len(range(int(low), int(high), node.step)) <= _EXPANDED:
        return Domain(_never, _int, [t.integer(i) for i in range(int(low), int(high), node.step)], False, False)
    first, last = (start, stop) if node.step > 0 else (t.add(stop, _ONE), t.add(start, _ONE))
    step = t.integer(abs(node.step))

    def inside(index: Term) -> Term:
        within = t.and_(t.at_most(first, index), t.less(index, last))
        if abs(node.step) == 1:
            return within
        return t.and_(within, t.equals(t.remainder(t.subtract(index, start), step), _ZERO))

    return Domain(inside, _int, None, True, start is not _ZERO or stop is not e.room.size)


def _never(index: Term) -> Term:
    return t.FALSE


def _int(index: Term) -> Val:
    return index


def _key(item: Val, type_: Type) -> Val:
    """Of a map one goes through the keys."""
    if isinstance(type_, MapOf):
        assert isinstance(item, tuple)
        return item[0]
    return item


def _unordered(type_: Type) -> bool:
    return isinstance(type_, MapOf) or (isinstance(type_, Sequence) and type_.name == "Set")
