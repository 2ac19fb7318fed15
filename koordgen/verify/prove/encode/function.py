"""Calls of functions: the encoder executes a `fun` symbolically.

An extern function is known only by its contract, a spec function only by its axioms.
"""

from __future__ import annotations

from collections.abc import Callable

from koordgen.lang.ir import decl
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.tree import walk
from koordgen.verify.prove.encode.context import ProofContext, symbol
from koordgen.verify.prove.encode.expr import Encoder
from koordgen.verify.prove.encode.loop import EncodingOf, temps_of
from koordgen.verify.prove.encode.stmt import LoopHead, SymbolicFrame
from koordgen.verify.prove.encode.values import (
    ConditionalCollection,
    EnumeratedCollection,
    FleetValue,
    OpaqueCollection,
    UpdatedCollection,
    Val,
    pick,
)
from koordgen.verify.prove.smt import term as t
from koordgen.verify.prove.smt.obligation import LabelledFormula
from koordgen.verify.prove.smt.term import Term


class Functions:
    """Functions of a program in one proof context.

    `assume_at_head`: receives the head of each loop with the encoding "cut", and adds the facts at the head.
    `brief`: True to add no facts about the results of functions with such loops. Most proofs do not need these
    facts."""

    def __init__(
        self, context: ProofContext, params: dict[str, Val], assume_at_head: Callable[[LoopHead], None], brief: bool
    ) -> None:
        program = context.program
        self.context, self.assume_at_head, self.brief = context, assume_at_head, brief
        self.functions = {f.name: f for f in program.functions}
        self.externs = {f.name: f for f in program.externs}
        self.runs: dict[tuple[object, ...], tuple[Val, list[LabelledFormula], tuple[Val, ...]]] = {}
        self.closed: dict[str, bool] = {}
        self.encoder = Encoder(context, params, self.call)

    def call(self, name: str, args: tuple[Val, ...], node: ir.Expr) -> Val:
        if name in self.functions:
            return self.run(self.functions[name], args)
        if name in self.externs:
            return self.extern(self.externs[name], args, node)
        return self.encoder.apply(name, symbol(name), args, node.type)

    def run(self, function: decl.Function, args: tuple[Val, ...]) -> Val:
        """Return the result of a call.

        Calls with equal arguments share one symbolic execution, but each call repeats the function's demands.
        SOUND: sharing is safe, because a function that calls no extern function adds no facts that depend on the
        program point of the call."""
        if not self.is_closed(function):
            return self.result(function, args)
        context, key = self.context, (function.name, *map(_identity, args))
        if key not in self.runs:
            with context.outermost(), context.separate_demands() as demands:
                self.runs[key] = self.result(function, args), demands, args
        result, demands, _ = self.runs[key]
        for demand in demands:
            context.demand(demand.term, demand.label, demand.line)
        return result

    def is_closed(self, function: decl.Function) -> bool:
        """Return whether a function calls no extern function, neither directly nor through other functions."""
        if function.name not in self.closed:
            called = [n for n in walk(function.block) if isinstance(n, (ir.Call, ir.ExternCall))]
            functions = [self.functions.get(n.name) for n in called]
            self.closed[function.name] = all(f is not None and self.is_closed(f) for f in functions)
        return self.closed[function.name]

    def result(self, function: decl.Function, args: tuple[Val, ...]) -> Val:
        frame = self.frame(function, args)
        depth = len(self.context.path)
        frame.block(function.block)
        found: Val | None = None
        for left in reversed(frame.exits):
            assert left.value is not None
            found = left.value if found is None else pick(t.all_of(left.path[depth:]), left.value, found)
        if not frame.heads and found is not None:
            return found
        # SOUND (over-approximation): for a loop encoded by a cut, only the facts at its head are known. So the
        # function's result is an arbitrary value that these facts allow. Equal arguments give equal results.
        self.context.note(f"{function.name}: the values that its loops write are known only by invariants and facts")
        result = self.encoder.apply(function.name, symbol(function.name), args, function.result)
        if found is not None and not self.brief:
            self.context.fact_if_reached(
                self.encoder.lists.same(result, found), f"result of {function.name}", function.span.line
            )
        return result

    def frame(
        self, function: decl.Function, args: tuple[Val, ...], encoding: EncodingOf | None = None
    ) -> SymbolicFrame:
        """Return a frame for the symbolic execution of a function, with its parameters set to `args`."""
        parameters = {p.name: p.type for p in function.parameters}
        types = {**parameters, **temps_of(function.block)}
        frame = SymbolicFrame(self.encoder, t.integer(-1), None, None, _nothing, types, self.assume_at_head, encoding)
        frame.brief = self.brief
        frame.temps = dict(zip(parameters, args, strict=True))
        return frame

    def extern(self, function: decl.ExternFunction, args: tuple[Val, ...], node: ir.Expr) -> Val:
        """Encode a call of an extern function: demand its `requires`, and assume its `ensures`.

        `ensures` is assumed only for runs that reach the call and fulfil `requires`. The semantics discards an event
        whose call breaks the contract."""
        result = self.encoder.apply(function.name, symbol(function.name), args, node.type)
        required, ensured = self.contract(function, args, result)
        for formula in required:
            self.context.demand(formula, f"{function.name} requires", node.span.line)
        for formula, line in ensured:
            label = f"contract of {function.name}"
            self.context.fact_if_reached(t.implies(t.all_of(required), formula), label, line)
        return result

    def contract(
        self, function: decl.ExternFunction, args: tuple[Val, ...], result: Val
    ) -> tuple[list[Term], list[tuple[Term, int]]]:
        """Return the formulas that a call requires, and the formulas that the contract ensures.

        Each ensured formula is paired with its line in the program."""
        types = {p.name: p.type for p in function.parameters}
        frame = SymbolicFrame(self.encoder, t.integer(-1), None, None, _nothing, types, self.assume_at_head)
        frame.temps = dict(zip(types, args, strict=True))
        required = [self.encoder.defined(formula, frame) for formula in function.requires]
        frame.temps["result"] = result
        return required, [(self.encoder.defined(formula, frame), formula.span.line) for formula in function.ensures]


def _identity(value: Val) -> object:
    """Return a hashable key of an argument. Arguments with equal keys have equal values in every model."""
    match value:
        case FleetValue(name):
            return "fleet", name
        case OpaqueCollection(term):
            return term
        case tuple():
            return tuple(map(_identity, value))
        case EnumeratedCollection() | ConditionalCollection() | UpdatedCollection():
            return id(value)
        case _:
            return value


def _nothing(node: ir.PortCall, args: tuple[Val, ...]) -> Val:
    raise AssertionError("a function calls a port")
