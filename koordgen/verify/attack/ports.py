"""Results of calls during an attack: calls of ports, such as a planner, and of extern functions.

A port may return any result that the assumptions about its module allow. So results are drawn at random, and results
that the assumptions exclude are dropped. Results of extern functions are unknown, because the attack does not run
Python functions of the user. A step that calls an extern function cannot be used.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

from koordgen.lang.ir import decl
from koordgen.lang.semantics.exact import NotExact
from koordgen.lang.semantics.exec import NoMeaning
from koordgen.lang.semantics.property import Asked
from koordgen.lang.semantics.state import NOTHING, State, World
from koordgen.lang.semantics.values import Value
from koordgen.verify.prove.report.model_reader import Unshowable, answered

# Largest number of turns (passes of loops) in one event. The attack abandons an event that exceeds this limit.
TURNS = 2_000

Draw = Callable[[State, int, str, tuple[Value, ...]], Iterable[Value]]
Question = tuple[int, str, tuple[Value, ...]]


class PortAnswer(NamedTuple):
    """Result of a port's call in an event of robot `pid`."""

    pid: int
    asked: Asked


class AttackPorts:
    """Callable ports and extern functions, as the semantics sees them during an attack.

    `draw`: proposes results of a port's call.
    `world`: functions that the semantics calls in place of ports and extern functions.
    `lacking`: reason why the present step cannot be used: a call without a known result; "" for a usable step."""

    def __init__(self, program: decl.Program, draw: Draw) -> None:
        self.program, self.draw = program, draw
        self.world = World({e.name: self._unknown(e.name) for e in program.externs}, self.answer, TURNS)
        self.lacking = ""
        self.state: State | None = None
        self.asked: dict[Question, Value] = {}
        self.given: Mapping[Question, Value] | None = None

    def begin(self, state: State, given: Iterable[PortAnswer] | None = None) -> None:
        """Prepare for a step from `state`: forget the results of earlier calls.

        `given`: the results of all calls that the step may make; None to draw the results at random."""
        self.state, self.lacking, self.asked = state, "", {}
        self.given = None if given is None else {(pid, a.port, a.args): a.answer for pid, a in given}

    def answers(self) -> tuple[PortAnswer, ...]:
        """Return the results of all port calls since the present step began."""
        return tuple([PortAnswer(pid, Asked(port, args, found)) for (pid, port, args), found in self.asked.items()])

    def answer(self, pid: int, port: str, args: tuple[Value, ...]) -> Value:
        question = (pid, port, args)
        if question not in self.asked:
            self.asked[question] = self._new(pid, port, args)
        return self.asked[question]

    def _new(self, pid: int, port: str, args: tuple[Value, ...]) -> Value:
        assert self.state is not None
        candidates = self.draw(self.state, pid, port, args) if self.given is None else self._known(pid, port, args)
        before = [Asked(p, a, found) for (own, p, a), found in self.asked.items() if own == pid]
        for candidate in candidates:
            try:
                answered(self.program, self.state, pid, [*before, Asked(port, args, candidate)], NOTHING)
            except (Unshowable, NotExact, NoMeaning):
                continue
            return candidate
        self.lacking = f"the assumptions allow none of the known results of {port}"
        raise LookupError(self.lacking)

    def _known(self, pid: int, port: str, args: tuple[Value, ...]) -> Iterable[Value]:
        assert self.given is not None
        return [self.given[pid, port, args]] if (pid, port, args) in self.given else []

    def _unknown(self, name: str) -> Callable[..., Value]:
        def call(*args: Value) -> Value:
            self.lacking = f"the result of the extern function {name} is unknown"
            raise LookupError(self.lacking)

        return call
