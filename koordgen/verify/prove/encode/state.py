"""States of the fleet as terms. Each variable is a function of the robot's pid.

The state after an event is the state before the event, overlaid with the event's writes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from koordgen.lang.ir.decl import Program
from koordgen.lang.ir.ports import clearable
from koordgen.lang.ir.types import PerRobot, Type
from koordgen.verify.prove.encode.context import ProofContext, symbol, symbols
from koordgen.verify.prove.encode.values import FleetValue, Val, pick
from koordgen.verify.prove.smt import term as t
from koordgen.verify.prove.smt.term import FunctionSymbol, Term

# Kind and name of a variable. The kinds are "local", "slot", "cell" and "port" (named "Module.port"). While an event or
# function is executed, there are two more kinds: "temp" is a local variable of a block, and "wrote" is the truth value
# "the cell or port was written".
Key = tuple[str, str]


def declared(program: Program) -> dict[Key, Type]:
    """Return the types of all variables of a program's state."""
    found: dict[Key, Type] = {("local", v.name): v.type for v in program.locals}
    found.update({("slot" if v.kind == "allread" else "cell", v.name): v.type for v in program.shared})
    for module in program.modules:
        for port in module.ports:
            if port.direction in ("sensor", "actuator"):
                found["port", f"{module.name}.{port.name}"] = port.type
    return found


def cleared(program: Program) -> frozenset[Key]:
    """Return the sensors that become false when an event commands one of their actuators."""
    return frozenset([("port", sensor) for sensor in clearable(program)])


def sensors(program: Program) -> frozenset[Key]:
    ports = [(m, p) for m in program.modules for p in m.ports if p.direction == "sensor"]
    return frozenset([("port", f"{m.name}.{p.name}") for m, p in ports])


class SymbolicState(Protocol):
    """State of the fleet.

    `of`: returns a variable of the robot with pid `robot`. For an allwrite variable (cell), the pid has no effect.
    `state_name`: the name of the state, a part of its symbols."""

    @property
    def types(self) -> Mapping[Key, Type]: ...

    @property
    def state_name(self) -> str: ...

    def of(self, key: Key, robot: Term) -> Val: ...


def slots(state: SymbolicState, name: str) -> FleetValue:
    """Return all robots' slots of an allread variable as one value.

    Two states return the same value if no robot wrote the variable between them."""
    key = ("slot", name)
    while (isinstance(state, UpdatedState) and key not in state.writes) or (isinstance(state, HavockedState)):
        state = state.before
    changed = None
    if isinstance(state, UpdatedState):
        changed = slots(state.before, name), state.own, state.writes[key]
    return FleetValue(
        f"{name}{state.state_name}", lambda robot: state.of(key, robot), PerRobot(state.types[key]), changed
    )


class ArbitraryState:
    """State with unknown variables. `state_name` is the suffix of the state's symbols."""

    def __init__(self, context: ProofContext, types: Mapping[Key, Type], state_name: str = "") -> None:
        self.context, self.types, self.state_name = context, types, state_name
        self.read: dict[tuple[Key, Term], Val] = {}
        self.symbols: dict[Key, list[FunctionSymbol]] = {}

    def of(self, key: Key, robot: Term) -> Val:
        found = self.read.get((key, robot))
        if found is None:
            type_, args = self.types[key], () if key[0] == "cell" else (robot,)
            functions = self.symbols.get(key)
            if functions is None:
                functions = self.symbols[key] = symbols(symbol(key[1]) + self.state_name, args, type_)
            found = self.read[key, robot] = self.context.applied(functions, args, type_)
        return found


class RoundStart:
    """State at the start of a round, reconstructed later in the same round for the robot `own`.

    The variables that only `own` writes, and the sensors in `shared`, are unchanged since the start of the round. They
    are read from the state `now`. All other variables are read from the arbitrary state `other`.

    `foreign`: ports that another application on the same robot may have changed; those of `own` are not unchanged."""

    def __init__(
        self, now: SymbolicState, other: ArbitraryState, own: Term, shared: frozenset[Key],
        foreign: frozenset[Key] = frozenset(),
    ) -> None:  # fmt: skip
        self.now, self.other, self.own, self.shared, self.foreign = now, other, own, shared, foreign
        self.types, self.state_name = now.types, "@start"
        self.used = False

    def of(self, key: Key, robot: Term) -> Val:
        if key in self.shared:
            return self.now.of(key, robot)
        self.used = True
        if key[0] == "cell" or key in self.foreign:
            return self.other.of(key, robot)
        own = self.other.context.same(robot, self.own)
        if isinstance(own, t.LiteralTerm):
            return (self.now if own.value else self.other).of(key, robot)
        return pick(own, self.now.of(key, robot), self.other.of(key, robot))


class UpdatedState:
    """State after the writes of one robot."""

    def __init__(
        self, context: ProofContext, before: SymbolicState, own: Term, writes: Mapping[Key, Val], state_name: str
    ) -> None:
        self.context, self.before, self.own, self.writes = context, before, own, writes
        self.types, self.state_name = before.types, state_name

    def of(self, key: Key, robot: Term) -> Val:
        if key not in self.writes:
            return self.before.of(key, robot)
        if key[0] == "cell":
            return self.writes[key]
        own = self.context.same(robot, self.own)
        if isinstance(own, t.LiteralTerm):
            return self.writes[key] if own.value else self.before.of(key, robot)
        return pick(own, self.writes[key], self.before.of(key, robot))


class HavockedState:
    """State after a step of the environment: the sensors of all robots have arbitrary new values."""

    def __init__(self, before: SymbolicState, after: ArbitraryState, moved: frozenset[Key]) -> None:
        self.before, self.after, self.moved = before, after, moved
        self.types, self.state_name = before.types, "@after"

    def of(self, key: Key, robot: Term) -> Val:
        return (self.after if key in self.moved else self.before).of(key, robot)
