"""Functions: `fun`s are executed symbolically.

Extern functions have contracts, spec functions have axioms.
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
    """Functions of a program in one context.

    `know` receives the head of each loop that is cut. `brief`: add no facts about what such loops leave behind, since
    most proofs need none."""

    def __init__(
        self, context: ProofContext, params: dict[str, Val], know: Callable[[LoopHead], None], brief: bool
    ) -> None:
        program = context.program
        self.context, self.know, self.brief = context, know, brief
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
        """Return the result of a call. Its demands are made at each call. Calls with equal arguments share one
        symbolic execution. SOUND: a run that calls no extern function adds no facts that depend on the call's place."""
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
        """Return whether a run calls no extern function."""
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
        # SOUND (over-approximation): only the facts at its head are known of a loop that is cut. The result is one
        # value for equal arguments, any of those that the facts allow.
        self.context.note(
            f"{function.name}: only the invariants and facts about turns are known of what its loops write"
        )
        result = self.encoder.apply(function.name, symbol(function.name), args, function.result)
        if found is not None and not self.brief:
            self.context.fact_if_reached(
                self.encoder.lists.same(result, found), f"result of {function.name}", function.span.line
            )
        return result

    def frame(
        self, function: decl.Function, args: tuple[Val, ...], encoding: EncodingOf | None = None
    ) -> SymbolicFrame:
        """Return the frame in which a function is about to run."""
        parameters = {p.name: p.type for p in function.parameters}
        types = {**parameters, **temps_of(function.block)}
        frame = SymbolicFrame(self.encoder, t.integer(-1), None, None, _nothing, types, self.know, encoding)
        frame.brief = self.brief
        frame.temps = dict(zip(parameters, args, strict=True))
        return frame

    def extern(self, function: decl.ExternFunction, args: tuple[Val, ...], node: ir.Expr) -> Val:
        """Encode a call of an extern function: demand what it requires, assume what it ensures.

        The latter holds where the call is made and has a result, since an event whose call breaks its contract is
        discarded."""
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
        """Return what a call requires, and what its result then satisfies, each with its line."""
        types = {p.name: p.type for p in function.parameters}
        frame = SymbolicFrame(self.encoder, t.integer(-1), None, None, _nothing, types, self.know)
        frame.temps = dict(zip(types, args, strict=True))
        required = [self.encoder.defined(formula, frame) for formula in function.requires]
        frame.temps["result"] = result
        return required, [(self.encoder.defined(formula, frame), formula.span.line) for formula in function.ensures]


def _identity(value: Val) -> object:
    """Return a key of an argument. Arguments with equal keys have equal values in every state."""
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
    raise AssertionError("a function calls no port")
