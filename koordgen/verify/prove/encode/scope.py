"""Scopes: values of the names in a property of the fleet, or in an assumption about one robot."""

from __future__ import annotations

from koordgen.lang.diagnostics import InternalError
from koordgen.lang.ir import expr as ir
from koordgen.verify.prove.encode.state import SymbolicState, slots
from koordgen.verify.prove.encode.values import FleetValue, Val
from koordgen.verify.prove.smt import term as t
from koordgen.verify.prove.smt.term import Term


class UnknownAnswer(Exception):
    """Raised if an assumption calls a callable port whose answer is not known in the scope."""


class FleetScope:
    """Scope of a property, which can read the shared store and the locals and ports of every robot."""

    def __init__(self, state: SymbolicState) -> None:
        self.state = state
        self.pid = t.integer(-1)
        self.temps: dict[str, Val] = {}

    def slot(self, name: str, index: Term) -> Val:
        return self.state.of(("slot", name), index)

    def slots(self, name: str) -> FleetValue:
        return slots(self.state, name)

    def cell(self, name: str) -> Val:
        return self.state.of(("cell", name), self.pid)

    def local_of(self, name: str, robot: Term) -> Val:
        return self.state.of(("local", name), robot)

    def port_of(self, name: str, robot: Term) -> Val:
        return self.state.of(("port", name), robot)

    def local(self, name: str) -> Val:
        raise InternalError("a property reads a local without naming its robot")

    def port(self, name: str, primed: bool) -> Val:
        raise InternalError("a property reads a port without naming its robot")

    def ask(self, node: ir.PortCall, args: tuple[Val, ...]) -> Val:
        raise UnknownAnswer


class RobotScope(FleetScope):
    """Scope of an assumption about one robot.

    A port denotes its value before the step. A primed port denotes its value during the step.

    `answers`: (callable port, arguments) -> answer."""

    def __init__(
        self, before: SymbolicState, after: SymbolicState, robot: Term, answers: dict[tuple[str, tuple[Val, ...]], Val]
    ) -> None:
        super().__init__(before)
        self.after, self.pid, self.answers = after, robot, answers

    def port(self, name: str, primed: bool) -> Val:
        return (self.after if primed else self.state).of(("port", name), self.pid)

    def ask(self, node: ir.PortCall, args: tuple[Val, ...]) -> Val:
        found = self.answers.get((f"{node.module}.{node.port}", args))
        if found is None:
            raise UnknownAnswer
        return found
