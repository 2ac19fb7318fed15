"""Functions: `fun`s are run on symbols, extern functions known by their contracts, spec functions by axioms."""

from __future__ import annotations

from koordgen.ir import decl
from koordgen.ir import expr as ir
from koordgen.prove import term as t
from koordgen.prove.encode.expr import Encoder
from koordgen.prove.encode.room import Room, symbol
from koordgen.prove.encode.stmt import Frame, Unsummarised
from koordgen.prove.encode.values import Val, pick
from koordgen.prove.term import Term


class Functions:
    """The functions of a program in one room."""

    def __init__(self, room: Room, params: dict[str, Val]) -> None:
        program = room.program
        self.room = room
        self.functions = {f.name: f for f in program.functions}
        self.externs = {f.name: f for f in program.externs}
        self.encoder = Encoder(room, params, self.call)

    def call(self, name: str, args: tuple[Val, ...], node: ir.Expr) -> Val:
        if name in self.functions:
            try:
                return self.run(self.functions[name], args)
            except Unsummarised:
                # SOUND: all that is known is that equal arguments give equal results.
                self.room.note(f"{name}: nothing is known of its result but that equal arguments give equal ones")
                return self.encoder.apply(name, symbol(name), args, node.type)
        if name in self.externs:
            return self.extern(self.externs[name], args, node)
        return self.encoder.apply(name, symbol(name), args, node.type)

    def run(self, function: decl.Function, args: tuple[Val, ...]) -> Val:
        frame = Frame(self.encoder, t.integer(-1), None, None, _nothing)
        frame.temps = {p.name: arg for p, arg in zip(function.parameters, args, strict=True)}
        depth = len(self.room.path)
        frame.block(function.block)
        found: Val | None = None
        for left in reversed(frame.exits):
            assert left.value is not None
            found = left.value if found is None else pick(t.all_of(left.path[depth:]), left.value, found)
        if found is None:
            raise Unsummarised
        return found

    def extern(self, function: decl.ExternFunction, args: tuple[Val, ...], node: ir.Expr) -> Val:
        """What it requires is demanded. What it ensures holds where the call is made and has a result: of one that
        breaks its contract the event is discarded."""
        result = self.encoder.apply(function.name, symbol(function.name), args, node.type)
        frame = Frame(self.encoder, t.integer(-1), None, None, _nothing)
        frame.temps = {p.name: arg for p, arg in zip(function.parameters, args, strict=True)}
        required: list[Term] = []
        for formula in function.requires:
            required.append(self.encoder.defined(formula, frame))
            self.room.demand(required[-1], f"{function.name} requires", node.span.line)
        frame.temps["result"] = result
        for formula in function.ensures:
            ensured = self.encoder.defined(formula, frame)
            label = f"contract of {function.name}"
            self.room.given(t.implies(t.all_of(required), ensured), label, formula.span.line)
        return result


def _nothing(node: ir.PortCall, args: tuple[Val, ...]) -> Val:
    raise AssertionError("a function calls no port")
