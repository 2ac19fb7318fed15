"""What a program calls, as a model has it: the answers of callable ports. What the model does not tell stays untold."""

from __future__ import annotations

from collections.abc import Sequence

from koordgen.lang.ir import decl
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.property import Asked, holds_assumption
from koordgen.lang.semantics.state import State, World
from koordgen.lang.semantics.values import Value
from koordgen.verify.prove.report.reading import Reader, Unshowable


class Served:
    """Answers the calls of one event in their order, and remembers them."""

    def __init__(self, program: decl.Program, reader: Reader) -> None:
        self.program = program
        self.reader = reader
        self.asked: list[Asked] = []
        self.missing: list[str] = []
        unknown = {f.name: self.unknown(f.name) for f in program.externs}
        self.world = World(unknown, self.answer)

    def unknown(self, name: str):  # type: ignore[no-untyped-def]
        def call(*args: Value) -> Value:
            self.missing.append(name)
            raise LookupError(name)

        return call

    def answer(self, pid: int, port: str, args: tuple[Value, ...]) -> Value:
        before = next((call.answer for call in self.asked if (call.port, call.args) == (port, args)), None)
        if before is not None:
            return before
        known = self.reader.answered_by(port)
        place = sum(call.port == port for call in self.asked)
        if place >= len(known):
            self.missing.append(port)
            raise LookupError(port)
        self.asked.append(Asked(port, args, known[place]))
        return known[place]

    def check(self, state: State, pid: int) -> None:
        """Raises Unshowable where something was asked that the model does not tell, or was answered as it must not."""
        if self.missing:
            raise Unshowable(f"what {self.missing[0]} yields is known only by what is said of it")
        answered(self.program, state, pid, self.asked, self.world)


def answered(program: decl.Program, state: State, pid: int, asked: Sequence[Asked], world: World) -> None:
    """Raises Unshowable where an assumption about what callable ports answer does not hold of some calls."""
    ports = state.robots[pid].ports
    count = len(state.robots)
    for module in program.modules:
        for assumption in module.assumptions:
            if not any(True for _ in decl.handed(assumption.formula)):
                continue
            try:
                if holds_assumption(assumption, program, ports, ports, pid, count, state.params, world, asked):
                    continue
            except Discarded as error:
                raise Unshowable(f"an assumption has no value in it: {error.reason}") from None
            raise Unshowable("an assumption about what a port answers does not hold in it")
