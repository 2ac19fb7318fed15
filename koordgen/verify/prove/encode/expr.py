"""Koord expressions as SMT terms.

A `Scope` gives the values of variables. Each condition under which an expression has a value becomes a demand.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from koordgen.lang.diagnostics import InternalError
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.types import INT, PerRobot, Sized, Type
from koordgen.verify.prove.encode.builtins import builtin
from koordgen.verify.prove.encode.context import ProofContext
from koordgen.verify.prove.encode.encoder import Scope
from koordgen.verify.prove.encode.geometry import Geometry, path_of
from koordgen.verify.prove.encode.lists import Lists
from koordgen.verify.prove.encode.quantifier import in_fleet, quantified
from koordgen.verify.prove.encode.values import (
    EnumeratedCollection,
    FleetValue,
    UpdatedCollection,
    Val,
    as_term,
    is_collection,
    parts_of,
    pick,
)
from koordgen.verify.prove.smt import term as t
from koordgen.verify.prove.smt.term import Term

_ZERO, _ONE, _HALF = t.integer(0), t.integer(1), t.real(0.5)
_EXPANDED = 8  # longest list whose elements are encoded separately


Call = Callable[[str, tuple[Val, ...], ir.Expr], Val]


class Encoder:
    """Encoder of expressions in one proof context.

    `params`: the values of the program's params (constants that the build sets).
    `call`: encodes a call of a `fun`, an extern function or a spec function."""

    def __init__(
        self, context: ProofContext, params: dict[str, Val], call: Callable[[str, tuple[Val, ...], ir.Expr], Val]
    ) -> None:
        self.context, self.params, self.call = context, params, call
        self.lists = Lists(context)
        self.geometry = Geometry(context, self.lists)
        # Function -> arguments of its calls. An axiom holds for all values, and is instantiated at these arguments.
        self.calls: dict[str, list[tuple[Val, ...]]] = {}
        # True: a quantifier demands that all its instances have values. False for assumed formulas, because these have
        # values.
        self.strict = False
        self.called_on: set[tuple[object, ...]] = set()

    def value(self, node: ir.Expr, scope: Scope) -> Val:
        t.step()
        return _READERS[type(node)](self, node, scope)

    def term(self, node: ir.Expr, scope: Scope) -> Term:
        return as_term(self.value(node, scope))

    def apply(self, name: str, symbol: str, args: tuple[Val, ...], type_: Type) -> Val:
        """Encode a call of a function that is known only by its contract or its axioms.

        The call becomes an uninterpreted function of the arguments."""
        leaves = tuple([leaf for arg in args for leaf in self.lists.leaves(arg)])
        if (name, leaves) not in self.called_on:
            self.called_on.add((name, leaves))
            self.calls.setdefault(name, []).append(args)
        return self.context.function(symbol, leaves, type_)

    # Encoding of reads

    def const(self, node: ir.Const, scope: Scope) -> Val:
        if isinstance(node.value, bool):
            return t.boolean(node.value)
        if isinstance(node.value, int):
            return t.integer(node.value)
        if isinstance(node.value, float):
            return t.real(node.value)
        return self.text(node.value, node.type)

    def text(self, text: str, type_: Type) -> Val:
        """Encode a string literal as a constant. The constants of different literals differ."""
        texts = self.context.texts
        if text not in texts:
            shown = "".join([c if c.isalnum() else "_" for c in text if c.isascii()])
            found = as_term(self.context.function(f"text@{len(texts)}@{shown}", (), type_))
            for other in texts.values():
                self.context.fact(t.not_(t.equals(other, found)), "string literals differ", 0)
            texts[text] = found
        return texts[text]

    def pid(self, node: ir.Pid, scope: Scope) -> Val:
        return scope.pid

    def size(self, node: ir.NSys, scope: Scope) -> Val:
        return self.context.size

    def ids(self, node: ir.Ids, scope: Scope) -> Val:
        return FleetValue("ID", lambda robot: robot, PerRobot(INT))

    def param(self, node: ir.ParamRead, scope: Scope) -> Val:
        return self.params[node.name]

    def local(self, node: ir.LocalRead, scope: Scope) -> Val:
        return scope.local(node.name)

    def temp(self, node: ir.TempRead, scope: Scope) -> Val:
        return scope.temps[node.name]

    def slot(self, node: ir.SlotRead, scope: Scope) -> Val:
        return scope.slot(node.name, self.robot(node.index, scope))

    def slots(self, node: ir.SlotsRead, scope: Scope) -> Val:
        return scope.slots(node.name)

    def cell(self, node: ir.SharedRead, scope: Scope) -> Val:
        return scope.cell(node.name)

    def port(self, node: ir.PortRead, scope: Scope) -> Val:
        return scope.port(f"{node.module}.{node.port}", node.primed)

    def local_of(self, node: ir.LocalOf, scope: Scope) -> Val:
        return scope.local_of(node.name, self.robot(node.robot, scope))

    def port_of(self, node: ir.PortOf, scope: Scope) -> Val:
        return scope.port_of(f"{node.module}.{node.port}", self.robot(node.robot, scope))

    def robot(self, node: ir.Expr, scope: Scope) -> Term:
        index = self.term(node, scope)
        if not self.context.indices.get(index, False) and index not in self.context.granted:
            self.context.demand(self.context.within(index), "the index is a robot's pid", node.span.line)
            self.context.robot(index)
        return index

    # Encoding of operators

    def widen(self, node: ir.Widen, scope: Scope) -> Val:
        return t.to_real(self.term(node.operand, scope))

    def unary(self, node: ir.Unary, scope: Scope) -> Val:
        value = self.value(node.operand, scope)
        if node.op == "not":
            return t.not_(as_term(value))
        if isinstance(value, tuple):
            return tuple([t.negate(as_term(part)) for part in value])
        return t.negate(as_term(value))

    def binary(self, node: ir.Binary, scope: Scope) -> Val:
        left, right = self.value(node.left, scope), self.value(node.right, scope)
        if is_collection(node.type):
            return UpdatedCollection("extended", path_of(left), (right,), node.type)
        if isinstance(node.type, Sized):
            return self.context.function(f"{node.type}.joined", (as_term(left), as_term(right)), node.type)
        if node.op in ("/", "//", "%"):
            divisor = as_term(right)
            zero = _ZERO if divisor.sort is t.INT else t.real(0)
            self.context.demand(t.not_(t.equals(divisor, zero)), "divisor is not zero", node.span.line)
        if node.op == "/" and node.left.type is INT:
            left, right = t.to_real(as_term(left)), t.to_real(as_term(right))
        if isinstance(left, tuple) or isinstance(right, tuple):
            self.geometry.measured = True
        match left, right:
            case tuple(), tuple():
                return tuple([_number(node.op, as_term(a), as_term(b)) for a, b in zip(left, right, strict=True)])
            case tuple(), _:
                return tuple([_number(node.op, as_term(a), as_term(right)) for a in left])
            case _, tuple():
                return tuple([_number(node.op, as_term(left), as_term(b)) for b in right])
            case _ if node.op == "**":
                return self.power(node, as_term(left), as_term(right))
            case _ if node.op in ("//", "%") and node.type is INT and t.number(as_term(right)) is None:
                return self.by_unknown(node.op, as_term(left), as_term(right))
            case _:
                return _number(node.op, as_term(left), as_term(right))

    def by_unknown(self, op: str, a: Term, b: Term) -> Term:
        """Encode `//` or `%` by a divisor that is not a literal, as an uninterpreted function with facts.

        SOUND: the facts are true. For a positive divisor d, they determine the result for dividends from 0 to 2 d - 1.
        This range suffices for steps around a ring. For all other dividends, the facts only bound the remainder."""
        self.context.note(
            "// and % by a divisor that is not a literal: exact for 0 <= dividend < 2 * divisor, otherwise only bounded"
        )
        quotient, rest = (t.apply(t.FunctionSymbol(f"{name}@", (t.INT, t.INT), t.INT), a, b) for name in ("div", "mod"))
        positive, negative = t.less(_ZERO, b), t.less(b, _ZERO)
        once = t.and_(positive, t.at_most(_ZERO, a), t.less(a, b))
        twice = t.and_(positive, t.at_most(b, a), t.less(a, t.add(b, b)))
        with self.context.about("quotient and remainder", 0):
            self.context.fact(t.implies(positive, t.and_(t.at_most(_ZERO, rest), t.less(rest, b))))
            self.context.fact(t.implies(negative, t.and_(t.less(b, rest), t.at_most(rest, _ZERO))))
            self.context.fact(t.implies(once, t.and_(t.equals(quotient, _ZERO), t.equals(rest, a))))
            self.context.fact(t.implies(twice, t.and_(t.equals(quotient, _ONE), t.equals(rest, t.subtract(a, b)))))
        return quotient if op == "//" else rest

    def power(self, node: ir.Binary, base: Term, exponent: Term) -> Val:
        times = t.number(exponent)
        if times is not None and times == times // 1 and 0 <= times <= 4:
            found = t.integer(1) if node.type is INT else t.real(1)
            for _ in range(int(times)):
                found = t.multiply(found, base)
            return found
        if node.type is INT:
            self.context.demand(t.at_most(_ZERO, exponent), "exponent is not negative", node.span.line)
        return self.context.function("power@", (base, exponent), node.type)

    def compare(self, node: ir.Compare, scope: Scope) -> Val:
        left, right = self.value(node.left, scope), self.value(node.right, scope)
        if node.op in ("==", "!="):
            same = self.lists.same(left, right)
            return same if node.op == "==" else t.not_(same)
        a, b = as_term(left), as_term(right)
        if isinstance(node.left.type, Sized):
            return self.context.function(f"{node.left.type} {node.op}", (a, b), node.type)
        match node.op:
            case "<":
                return t.less(a, b)
            case "<=":
                return t.at_most(a, b)
            case ">":
                return t.less(b, a)
            case _:
                return t.at_most(b, a)

    def contains(self, node: ir.Contains, scope: Scope) -> Val:
        """Return the term "the Rect, Ball, string, fleet or collection contains the item"."""
        item, held = self.value(node.item, scope), self.value(node.values, scope)
        match str(node.values.type):
            case "Rect":
                assert isinstance(item, tuple) and isinstance(held, tuple)
                low, high = held
                assert isinstance(low, tuple) and isinstance(high, tuple)
                self.geometry.measured = True
                axes = zip(item, low, high, strict=True)
                return t.all_of([_between(as_term(x), as_term(a), as_term(b)) for x, a, b in axes])
            case "Ball":
                assert isinstance(held, tuple)
                return t.at_most(self.geometry.distance(item, held[0]), as_term(held[1]))
            case "string":
                return self.context.function("string.has", (as_term(held), as_term(item)), node.type)
        if isinstance(held, FleetValue):
            return in_fleet(self, held, item)
        return self.lists.has(path_of(held), item)

    def logic(self, node: ir.Logic, scope: Scope) -> Val:
        left = self.term(node.left, scope)
        if left is (t.FALSE if node.op == "and" else t.TRUE):
            return left
        with self.context.under(left if node.op == "and" else t.not_(left)):
            right = self.term(node.right, scope)
        return t.and_(left, right) if node.op == "and" else t.or_(left, right)

    def conditional(self, node: ir.Conditional, scope: Scope) -> Val:
        condition = self.term(node.condition, scope)
        if isinstance(condition, t.LiteralTerm):
            return self.value(node.then if condition.value else node.orelse, scope)
        with self.context.under(condition):
            then = self.value(node.then, scope)
        with self.context.under(t.not_(condition)):
            orelse = self.value(node.orelse, scope)
        return pick(condition, then, orelse)

    # Encoding of records, tuples and collections

    def make(self, node: ir.Make, scope: Scope) -> Val:
        items = tuple([self.value(item, scope) for item in node.items])
        if is_collection(node.type):
            return EnumeratedCollection(items, node.type)
        if parts_of(node.type) is not None:
            return items
        return self.context.function(f"{node.type}.new", (), node.type)

    def field(self, node: ir.Field, scope: Scope) -> Val:
        whole = self.value(node.operand, scope)
        if isinstance(whole, tuple):
            return whole[self.part(node.operand.type, node.name)]
        return self.context.function(f"{node.operand.type}.{node.name}", (as_term(whole),), node.type)

    def part(self, type_: Type, name: str) -> int:
        parts = parts_of(type_)
        assert parts is not None
        return [part for part, _ in parts].index(name)

    def item(self, node: ir.Item, scope: Scope) -> Val:
        whole = self.value(node.operand, scope)
        assert isinstance(whole, tuple)
        return whole[node.index]

    def with_(self, node: ir.With, scope: Scope) -> Val:
        whole, new = self.value(node.operand, scope), self.value(node.value, scope)
        assert isinstance(whole, tuple)
        place = self.part(node.operand.type, node.name)
        return (*whole[:place], new, *whole[place + 1 :])

    def at(self, node: ir.At, scope: Scope) -> Val:
        whole, index = self.value(node.operand, scope), self.term(node.index, scope)
        if isinstance(node.operand.type, Sized):
            long = as_term(self.context.function("string.len", (as_term(whole),), INT))
            self.in_range(index, long, node)
            return self.context.function("string.at", (as_term(whole), index), node.type)
        xs = path_of(whole)
        self.in_range(index, self.lists.length(xs), node)
        return self.lists.element(xs, index)

    def in_range(self, index: Term, length: Term, node: ir.Expr) -> None:
        inside = t.and_(t.at_most(_ZERO, index), t.less(index, length))
        self.context.demand(inside, "index in range", node.span.line)

    def slice(self, node: ir.Slice, scope: Scope) -> Val:
        whole = self.value(node.operand, scope)
        bounds = [None if b is None else self.term(b, scope) for b in (node.start, node.stop)]
        for bound in bounds:
            if bound is not None:
                self.context.demand(t.at_most(_ZERO, bound), "bound of a slice is not negative", node.span.line)
        name = f"{node.type}.slice" + "".join(["_" if b is None else "i" for b in bounds])
        args = tuple([b for b in bounds if b is not None])
        return self.context.function(name, (*self.lists.leaves(whole), *args), node.type)

    # Encoding of calls

    def called(self, node: ir.Call | ir.ExternCall, scope: Scope) -> Val:
        return self.call(node.name, tuple([self.value(arg, scope) for arg in node.args]), node)

    def asked(self, node: ir.PortCall, scope: Scope) -> Val:
        return scope.ask(node, tuple([self.value(arg, scope) for arg in node.args]))

    def builtin(self, node: ir.Builtin, scope: Scope) -> Val:
        return builtin(self, node, tuple([self.value(arg, scope) for arg in node.args]))

    def defined(self, node: ir.Expr, scope: Scope) -> Term:
        """Return the term "the formula has a value and is true"."""
        return t.and_(*self.parts(node, scope))

    def parts(self, node: ir.Expr, scope: Scope) -> tuple[Term, Term]:
        """Return the terms "the formula has a value" and "the formula is true, if it has a value"."""
        context = self.context
        kept = context.path, context.demands
        # These lines do the work of the context's `outermost` and `separate_demands`. The code is inlined for speed,
        # because it runs for each instance of a quantifier.
        context.path, context.demands = (), []
        try:
            formula = self.term(node, scope)
            return t.all_of([demand.term for demand in context.demands]), formula
        finally:
            context.path, context.demands = kept


def _between(x: Term, a: Term, b: Term) -> Term:
    """Return the term "x is between a and b", for a <= b as well as for b <= a."""
    return t.or_(t.and_(t.at_most(a, x), t.at_most(x, b)), t.and_(t.at_most(b, x), t.at_most(x, a)))


def _number(op: str, a: Term, b: Term) -> Term:
    match op:
        case "+":
            return t.add(a, b)
        case "-":
            return t.subtract(a, b)
        case "*":
            return t.multiply(a, b)
        case "/":
            return t.divide(a, b)
        case "//" if a.sort is t.INT:
            return t.floor_divide(a, b)
        case "//":
            return t.to_real(t.to_int(t.divide(a, b)))
        case "%" if a.sort is t.INT:
            return t.remainder(a, b)
        case "%":
            return t.subtract(a, t.multiply(b, t.to_real(t.to_int(t.divide(a, b)))))
        case _:
            raise InternalError(f"no operator {op}")


_READERS: dict[type, Callable[[Encoder, Any, Scope], Val]] = {
    ir.Const: Encoder.const,
    ir.Pid: Encoder.pid,
    ir.NSys: Encoder.size,
    ir.Ids: Encoder.ids,
    ir.ParamRead: Encoder.param,
    ir.LocalRead: Encoder.local,
    ir.TempRead: Encoder.temp,
    ir.SlotRead: Encoder.slot,
    ir.SlotsRead: Encoder.slots,
    ir.SharedRead: Encoder.cell,
    ir.PortRead: Encoder.port,
    ir.LocalOf: Encoder.local_of,
    ir.PortOf: Encoder.port_of,
    ir.Widen: Encoder.widen,
    ir.Unary: Encoder.unary,
    ir.Binary: Encoder.binary,
    ir.Compare: Encoder.compare,
    ir.Contains: Encoder.contains,
    ir.Logic: Encoder.logic,
    ir.Conditional: Encoder.conditional,
    ir.Quantified: quantified,
    ir.Make: Encoder.make,
    ir.Field: Encoder.field,
    ir.Item: Encoder.item,
    ir.At: Encoder.at,
    ir.Slice: Encoder.slice,
    ir.With: Encoder.with_,
    ir.Builtin: Encoder.builtin,
    ir.Call: Encoder.called,
    ir.ExternCall: Encoder.called,
    ir.PortCall: Encoder.asked,
}
