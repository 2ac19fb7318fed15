"""Quantifiers, and the domains of quantifiers and `for` loops."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from koordgen.lang.ir import expr as ir
from koordgen.lang.ir import stmt
from koordgen.lang.ir.tree import Part, walk
from koordgen.lang.ir.types import MapOf, PerRobot, Sequence, Type
from koordgen.verify.prove.encode.context import ProofContext
from koordgen.verify.prove.encode.encoder import ExprEncoder, Scope
from koordgen.verify.prove.encode.geometry import path_of
from koordgen.verify.prove.encode.values import EnumeratedCollection, FleetValue, Val
from koordgen.verify.prove.smt import term as t
from koordgen.verify.prove.smt.term import Term

_ZERO, _ONE = t.integer(0), t.integer(1)
_EXPANDED = 8  # largest domain whose elements are encoded separately


class IterationDomain(NamedTuple):
    """Domain of a quantifier or of a `for` loop.

    The positions in the domain are the ints `start`, `start + step` and so on, before `stop`.

    `inside`: returns the term "this int is a position in the domain".
    `element`: returns the element at a position.
    `listed`: all elements, if they can be enumerated; None otherwise.
    `robots`: whether positions may be pids of robots.
    `places`: whether positions may be positions in a list."""

    inside: Callable[[Term], Term]
    element: Callable[[Term], Val]
    listed: list[Val] | None
    robots: bool
    places: bool
    start: Term
    stop: Term
    step: int

    def ahead(self, index: Term) -> Term:
        """Return the term "a loop at position `index` has at least one element left"."""
        return t.less(index, self.stop) if self.step > 0 else t.less(self.stop, index)

    def not_after(self, a: Term, b: Term) -> Term:
        """Return the term "position `a` comes before position `b` in the loop, or equals `b`"."""
        return t.at_most(a, b) if self.step > 0 else t.at_most(b, a)

    def passed(self, index: Term, head: Term) -> Term:
        """Return the term "a loop whose next position is `head` has already processed position `index`"."""
        before = t.less(index, head) if self.step > 0 else t.less(head, index)
        reached = self.not_after(self.start, index)
        return t.all_of([before, reached, *self.on_grid(index)])

    def on_grid(self, index: Term) -> list[Term]:
        """Return the terms "`index` is `start` plus a multiple of `step`"; no terms if `step` is 1 or -1."""
        if abs(self.step) == 1:
            return []
        return [t.equals(t.remainder(t.subtract(index, self.start), t.integer(abs(self.step))), _ZERO)]


def quantified(e: ExprEncoder, node: ir.Quantified, scope: Scope) -> Val:
    """Encode a quantifier as a truth value that agrees with each encoded instance of the quantifier.

    If `e.strict`, a demand states that all instances have values. A `not exists` with an instance without a value then
    has no value.
    SOUND: this demand is stronger than the semantics. The semantics stops at the first instance that decides the
    quantifier."""
    every = node.kind == "forall"
    over = domain(e, node.domain, scope, node.body, node.name)
    temps, strict = dict(scope.temps), e.strict

    def evaluated(element: Val) -> tuple[Term, Term]:
        kept, scope.temps = scope.temps, {**temps, node.name: element}
        around, e.strict = e.strict, strict
        try:
            with e.context.grant(element if isinstance(node.domain, ir.Ids) else None):
                return e.parts(node.body, scope)
        finally:
            scope.temps, e.strict = kept, around

    def holds(element: Val) -> Term:
        return t.and_(*evaluated(element))

    def has_value(index: Term) -> Term:
        return t.implies(over.inside(index), evaluated(over.element(index))[0])

    if e.strict and over.listed is not None:
        e.context.demand(t.all_of([evaluated(element)[0] for element in over.listed]), "instances", node.span.line)
    elif e.strict and _may_fail(e, node, scope):
        has = proxy(e.context, has_value, node.name, over.robots, over.places)
        e.context.demand(has, "instances", node.span.line)
    if over.listed is not None:
        parts = [holds(element) for element in over.listed]
        return t.all_of(parts) if every else t.any_of(parts)

    def instance(index: Term) -> Term:
        held = holds(over.element(index))
        return t.implies(over.inside(index), held if every else t.not_(held))

    found = proxy(e.context, instance, node.name, over.robots, over.places)
    return found if every else t.not_(found)


_PARTIAL = ("/", "//", "%", "**")
_TOTAL = frozenset(("distance", "path_distance", "clear", "abs", "min", "max", "sum", "len", "count", "get", "keys",
                    "values", "items", "union", "intersection", "difference", "Point", "Pose", "Grid", "Rect", "Ball",
                    "sorted", "reversed", "floor", "ceil", "round", "str", "merge", "center"))  # fmt: skip


def _may_fail(e: ExprEncoder, node: ir.Quantified, scope: Scope) -> bool:
    """Return whether an instance of a quantifier may have no value, judged by the kinds of its operations."""
    named = {node.name} if isinstance(node.domain, ir.Ids) else set()
    for part in walk(node.body):
        if isinstance(part, ir.Quantified) and isinstance(part.domain, ir.Ids):
            named.add(part.name)
    named.update(name for name, value in scope.temps.items() if value in e.context.granted and name != node.name)
    for part in walk(node.body):
        match part:
            case ir.Binary(op) if op in _PARTIAL:
                return True
            case ir.Builtin(name) if name not in _TOTAL:
                return True
            case ir.At() | ir.Slice() | ir.Call() | ir.ExternCall() | ir.PortCall():
                return True
            case ir.SlotRead(_, robot) | ir.LocalOf(_, robot) | ir.PortOf(_, _, robot):
                if not (isinstance(robot, ir.TempRead) and robot.name in named):
                    return True
            case _:
                pass
    return False


def proxy(
    context: ProofContext, instance: Callable[[Term], Term], name: str, robots: bool = True, places: bool = False
) -> Term:
    """Return a truth value that is true exactly if all instances are true.

    If the truth value is false, the instance at a new constant, the witness, is false. If the truth value is true,
    every instance is true; this universal formula is instantiated later."""
    some = context.new(name, t.INT)
    first = instance(some)
    found = context.new(f"forall {name}", t.BOOL)
    context.element(some, robots, places)
    context.fact(t.or_(found, t.not_(first)), "a witness at which the formula is false")
    context.for_all(lambda index: t.implies(found, instance(index)), robots, places)
    return found


def in_fleet(e: ExprEncoder, xs: FleetValue, item: Val) -> Term:
    """Return the term "the value of some robot equals this item"."""
    context = e.context
    key = (xs.name, *e.lists.leaves(item))
    if key not in context.absent:
        context.absent[key] = proxy(
            context, lambda index: t.implies(context.within(index), t.not_(e.lists.same(xs.slot(index), item))), "robot"
        )
    return t.not_(context.absent[key])


def domain(e: ExprEncoder, node: ir.Expr, scope: Scope, body: Part, name: str) -> IterationDomain:
    """Return the domain of a quantifier or a loop. `name` is the variable of the element in `body`."""
    if isinstance(node, ir.Range):
        return _range(e, node, scope, body, name)
    xs = path_of(e.value(node, scope))
    listed = None
    if (
        isinstance(xs, EnumeratedCollection)
        and len(xs.items) <= _EXPANDED
        and (len(xs.items) < 2 or not _unordered(node.type))
    ):
        listed = [_key(item, node.type) for item in xs.items]
    context, long, fleet = e.context, e.lists.length(xs), isinstance(xs, FleetValue)

    def inside(index: Term) -> Term:
        if fleet and context.indices.get(index, False):
            return t.TRUE
        return t.and_(t.at_most(_ZERO, index), t.less(index, long))

    return IterationDomain(
        inside, lambda i: _key(e.lists.element(xs, i), node.type), listed, fleet, not fleet, _ZERO, long, 1
    )


def _range(e: ExprEncoder, node: ir.Range, scope: Scope, body: Part, name: str) -> IterationDomain:
    start, stop = e.term(node.start, scope), e.term(node.stop, scope)
    low, high = t.number(start), t.number(stop)
    if stop is e.context.size and e.context.robots is None:
        high = None  # robots without numbers cannot be enumerated
    listed: list[Val] | None = None
    if low is not None and high is not None and len(range(int(low), int(high), node.step)) <= _EXPANDED:
        listed = [t.integer(i) for i in range(int(low), int(high), node.step)]
    first, last = (start, stop) if node.step > 0 else (t.add(stop, _ONE), t.add(start, _ONE))
    step = t.integer(abs(node.step))

    def inside(index: Term) -> Term:
        within = t.and_(t.at_most(first, index), t.less(index, last))
        if abs(node.step) == 1:
            return within
        return t.and_(within, t.equals(t.remainder(t.subtract(index, start), step), _ZERO))

    whole = start is _ZERO and stop is e.context.size
    robots = names_robots(body, name) or _speaks_of(start, e.context.size) or _speaks_of(stop, e.context.size)
    return IterationDomain(inside, _int, listed, robots, not whole, start, stop, node.step)


def _speaks_of(term: Term, part: Term) -> bool:
    return term is part or (isinstance(term, t.Op) and any(_speaks_of(arg, part) for arg in term.args))


def names_robots(body: Part, name: str) -> bool:
    """Return whether `body` may use the int variable `name` as the pid of a robot.

    SOUND: a variable that is assigned or passed to a function counts as a pid."""
    for part in walk(body):
        match part:
            case ir.SlotRead(_, index) | ir.LocalOf(_, index) | ir.PortOf(_, _, index):
                used: Part = index
            case ir.At(operand, index) if isinstance(operand.type, PerRobot):
                used = index
            case ir.Compare(_, left, right) if any(isinstance(n, (ir.Pid, ir.NSys)) for n in walk((left, right))):
                used = (left, right)
            case ir.Call() | ir.ExternCall() | stmt.Assign() | stmt.Let() | stmt.Return():
                used = part
            case _:
                continue
        if any(isinstance(n, ir.TempRead) and n.name == name for n in walk(used)):
            return True
    return False


def _int(index: Term) -> Val:
    return index


def _key(item: Val, type_: Type) -> Val:
    """Return the value of a loop's variable for an element: the key for a map, the element otherwise."""
    if isinstance(type_, MapOf):
        assert isinstance(item, tuple)
        return item[0]
    return item


def _unordered(type_: Type) -> bool:
    return isinstance(type_, MapOf) or (isinstance(type_, Sequence) and type_.name == "Set")
