"""Counterexamples: states from a solver's model, and the step that the executable semantics runs.

The solver's answer `sat` is not trusted. The semantics runs the step with rational numbers, from a state in which the
invariants hold. A counterexample is shown only if the run fails as the solver claims: an invariant is false after the
step, or the event has no result.
"""

from __future__ import annotations

import math
from base64 import b64encode
from collections.abc import Mapping
from fractions import Fraction
from typing import Any, NamedTuple

from koordgen.lang.diagnostics import InternalError
from koordgen.lang.ir import decl, stmt
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.tree import walk
from koordgen.lang.node import replace
from koordgen.lang.semantics.eval import Discarded, StateView, elements, holds
from koordgen.lang.semantics.exact import NotExact, made_exact
from koordgen.lang.semantics.exec import Budget, NoMeaning, library
from koordgen.lang.semantics.property import holds_assumption, holds_property
from koordgen.lang.semantics.state import NOTHING, Robot, State, Store
from koordgen.lang.semantics.step import Step, applied, enabled, execute, has_priority, initial, no_port, run_init
from koordgen.lang.semantics.values import RecordValue, Value
from koordgen.runtime.values.gridmap import GridMap
from koordgen.runtime.values.points import Grid, Opaque, Point, Pose, Scan
from koordgen.verify.prove.obligations.guarantees import TRANSITIVE
from koordgen.verify.prove.obligations.interface import ALONE, GuaranteeInScope, Interface
from koordgen.verify.prove.report.model_reader import ModelAnswers, ModelReader, Unshowable
from koordgen.verify.prove.smt.obligation import Obligation, StateCell, StateName


class Conjunct(NamedTuple):
    """Conjunct that makes a formula false.

    `formula`: the conjunct.
    `names`: the values of the quantified names that the conjunct reads."""

    formula: ir.Expr
    names: Mapping[str, Value]


class Counterexample(NamedTuple):
    """Counterexample: a step that leads from a state in which all invariants hold to a failure.

    `begun`: the shared store at the round's start. An event without a lock reads this store.
    `pid`: the robot that runs the event; None if the step moves all robots.
    `failed`: the conjunct that is false after the step; None if the event has no result.
    `discarded`: the reason why the event has no result, if the failure is a missing result.
    `seen`: names of the variables that the obligation mentions."""

    invariant: str
    kind: str
    event: str
    pid: int | None
    file: str
    line: int
    begun: Store
    before: State
    after: State
    failed: Conjunct | None
    discarded: str
    seen: frozenset[str]


class ModelStates:
    """States of the program, built from the variables' values in a solver's model."""

    def __init__(
        self, program: decl.Program, obligation: Obligation, reader: ModelReader, robots: int,
        interface: Interface = ALONE,
    ) -> None:  # fmt: skip
        self.obligation, self.interface = obligation, interface
        self.robots = robots
        self.reader = reader
        params = {c.name: self.value(c) for c in obligation.cells if c.name in {p.name for p in program.params}}
        self.program = with_values(program, params)

    def value(self, cell: StateCell) -> Value:
        return self.reader.value(cell.type, cell.terms, cell.name)

    def state(self, state_name: StateName) -> State:
        """Return one of the obligation's states of the fleet.

        A variable that the obligation does not mention has its initial value."""
        first = exact_state(initial(self.program, self.robots))
        locals_ = [dict(robot.locals) for robot in first.robots]
        ports = [dict(robot.ports) for robot in first.robots]
        slots = {name: list(values) for name, values in first.store.slots.items()}
        cells = dict(first.store.cells)
        for cell in self.obligation.cells:
            if cell.state_name != state_name or cell.name in first.params:
                continue
            if cell.robot is None:
                if cell.name in cells:
                    cells[cell.name] = self.value(cell)
                continue
            pid = self.reader.of[id(cell.robot)]
            if not isinstance(pid, int) or not 0 <= pid < self.robots:
                continue
            for places in (locals_[pid], ports[pid]):
                if cell.name in places:
                    places[cell.name] = self.value(cell)
            if cell.name in slots:
                slots[cell.name][pid] = self.value(cell)
        robots = tuple(Robot(own, port, False) for own, port in zip(locals_, ports, strict=True))
        store = Store({name: tuple(values) for name, values in slots.items()}, cells)
        return first._replace(robots=robots, store=store, round=1)

    def has(self, state_name: StateName) -> bool:
        return any(cell.state_name == state_name for cell in self.obligation.cells)


def with_values(program: decl.Program, values: Mapping[str, Value]) -> decl.Program:
    """Return the program with `values` as the default values of params."""
    params = [replace(p, default=constant(values[p.name], p)) if p.name in values else p for p in program.params]
    return replace(program, params=tuple(params))


def constant(value: Value, param: decl.Param) -> ir.Expr:
    """Return a value as a constant expression.

    The constant may be ill-typed, for example a fraction. Only the semantics may use the expression, because the
    semantics does not check types."""
    return ir.Const(value, param.type, param.span)  # type: ignore[arg-type]


def exact_state(state: State) -> State:
    """Return a state in which all numbers are fractions."""
    robots = tuple(Robot(exact_all(r.locals), exact_all(r.ports), r.stopped) for r in state.robots)
    slots = {name: tuple(map(made_exact, values)) for name, values in state.store.slots.items()}
    return State(exact_all(state.params), robots, Store(slots, exact_all(state.store.cells)), state.round)


def exact_all(values: Mapping[str, Value]) -> dict[str, Value]:
    return {name: made_exact(value) for name, value in values.items()}


def run_model(
    program: decl.Program, obligation: Obligation, reader: ModelReader, robots: int, interface: Interface = ALONE
) -> Counterexample:
    """Run the step of a model with the executable semantics.

    `program`: the program with exact numbers and with the invariants that may be assumed.
    `reader`: the reader that has read the model's values.
    `interface`: the interface with the guarantees that may be assumed.
    Raises Unshowable if the run does not fail as the solver claims."""
    try:
        reading = ModelStates(program, obligation, reader, robots, interface)
        match obligation.kind:
            case "base":
                return _base(reading)
            case "environment":
                return _environment(reading)
            case "well-defined" if obligation.event == "init":
                return _init(reading)
            case "loop" if obligation.event not in {event.name for event in program.events}:
                raise Unshowable("iterations of loops are run only in events")
            case "interference":
                return _others(reading)
            case "guarantee" if obligation.event not in {event.name for event in program.events}:
                return _guarantee(reading)
            case "event" | "well-defined" | "loop" | "guarantee":
                return _event(reading)
            case _:
                raise InternalError(f"{obligation.name} has no counterexample")
    except NotExact as error:
        raise Unshowable(f"the step cannot be run exactly: {error}") from None
    except NoMeaning as error:
        raise Unshowable(f"the step cannot be run: {error}") from None


def _base(reading: ModelStates) -> Counterexample:
    before, after, discarded = _ran_init(reading)
    if discarded is not None:
        raise Unshowable(f"no mission begins: init has no result, {discarded.outcome}")
    return _failed_step(reading, before.store, before, after, None, "")


def _init(reading: ModelStates) -> Counterexample:
    before, _, discarded = _ran_init(reading)
    if discarded is None:
        raise Unshowable("init has a result when the semantics runs it")
    return _failed_step(reading, before.store, before, before, discarded.pid, str(discarded.outcome))


def _ran_init(reading: ModelStates) -> tuple[State, State, Step | None]:
    """Return the fleet before and after `init`, and the first discarded `init`; None if none is discarded."""
    before = reading.state("before" if reading.has("before") else "round start")
    for property_ in reading.program.properties:
        if property_.kind == "initially" and not is_true(property_, reading.program, before):
            raise Unshowable("the first state of the counterexample violates an `initially` property")
    served = ModelAnswers(reading.program, reading.reader)
    after, steps = run_init(reading.program, before, served.world)
    if served.missing or served.asked:
        raise Unshowable("init calls functions or ports whose results are known only by their contracts")
    return before, after, next((s for s in steps if isinstance(s.outcome, Discarded)), None)


def _environment(reading: ModelStates) -> Counterexample:
    program = reading.program
    before, after = reading.state("before"), reading.state("after")
    sensors = [f"{m.name}.{p.name}" for m in program.modules for p in m.ports if p.direction == "sensor"]
    moved = [
        old._replace(ports={**old.ports, **{name: new.ports[name] for name in sensors}})
        for old, new in zip(before.robots, after.robots, strict=True)
    ]
    _relied_upon(reading, before)
    for pid, (old, new) in enumerate(zip(before.robots, moved, strict=True)):
        if not is_allowed(program, old.ports, new.ports, pid, before):
            raise Unshowable("the step of the counterexample violates an assumption")
    return _failed_step(reading, before.store, before, before._replace(robots=tuple(moved)), None, "")


def is_allowed(
    program: decl.Program, old: Mapping[str, Value], new: Mapping[str, Value], pid: int, state: State
) -> bool:
    """Return whether one robot's step satisfies every assumption of the modules.

    Raises Unshowable if an assumption cannot be evaluated."""
    try:
        return all(
            holds_assumption(a, program, old, new, pid, len(state.robots), state.params)
            for module in program.modules
            for a in module.assumptions
        )
    except Discarded as error:
        raise Unshowable(f"an assumption has no value in the step of the counterexample: {error.reason}") from None


def _event(reading: ModelStates) -> Counterexample:
    program, obligation = reading.program, reading.obligation
    before = reading.state("before")
    start = reading.state("round start") if reading.has("round start") else before
    begun = start.store
    event = next(e for e in program.events if e.name == obligation.event)
    seen = before if event.lock is not None else before._replace(store=begun)
    _relied_upon(reading, before)
    _relied_upon(reading, start)
    _kept_by_others(reading, start, before)
    why = "no robot can take the step"
    for pid in range(reading.robots):
        served = ModelAnswers(program, reading.reader)
        try:
            if not has_priority(program, event, before._replace(store=begun), pid, served.world):
                why = "an earlier event of the same priority block runs instead"
                continue
            if not enabled(program, event, seen, pid, served.world):
                continue
            outcome = execute(program, event.effect, seen, pid, served.world)
        except (Discarded, InternalError) as fault:
            outcome = fault if isinstance(fault, Discarded) else Discarded(str(fault), event.span)
        served.check(seen, pid)
        if isinstance(outcome, Discarded):
            why = outcome.reason
            if obligation.kind == "well-defined":
                return _failed_step(reading, begun, before, before, pid, str(outcome))
            continue
        after = applied(program, before, Step(pid, event.name, outcome))
        stated = [claim for claim in walk(event.effect) if isinstance(claim, stmt.LoopInvariant)]
        for claim in stated if obligation.kind == "loop" else ():
            if claim.span in outcome.violated and obligation.invariant == f"line {claim.span.line}":
                return _seen(reading, begun, before, after, pid, Conjunct(claim.formula, {}), "")
        if obligation.kind == "guarantee":
            broken = _broken(reading, before, after)
            if broken is not None:
                return _seen(reading, begun, before, after, pid, broken, "")
        if obligation.kind == "event" and not _are_all_true(obligation.invariant, program, after):
            return _failed_step(reading, begun, before, after, pid, "")
        why = "the step preserves the invariant when the semantics runs it"
    raise Unshowable(why)


def _relied_upon(reading: ModelStates, state: State) -> None:
    program = reading.program
    for property_ in program.properties:
        if property_.kind == "invariant" and not is_true(property_, program, state):
            raise Unshowable(f"{property_.name} does not hold before the step")
    for guarantee in reading.interface.guarantees:
        if not guarantee.is_step and guarantee_failure(guarantee, program, state, state) is not None:
            raise Unshowable(f"{guarantee.label} does not hold before the step")


# Guarantees and steps of other applications


def guarantee_failure(
    guarantee: GuaranteeInScope, program: decl.Program, before: State, after: State
) -> Conjunct | None:
    """Return the conjunct that makes a guarantee false between two states; None if the guarantee holds.

    A state guarantee reads `before` only."""
    kind, name = guarantee.key
    first, last = (s.store.slots[name] if kind == "slot" else s.store.cells[name] for s in (before, after))
    view = library(program, len(before.robots), before.params, NOTHING, Budget(), no_port)
    temps = {guarantee.before: first, **({guarantee.after: last} if guarantee.is_step else {})}
    return _failing_conjunct(guarantee.formula, view._replace(temps=temps))


def _broken(reading: ModelStates, before: State, after: State) -> Conjunct | None:
    """Return the conjunct of the obligation's guarantee that a step makes false; None if the step keeps it."""
    wanted = next(g for g in reading.interface.guarantees if g.label == reading.obligation.invariant)
    return guarantee_failure(wanted, reading.program, before if wanted.is_step else after, after)


def _kept_by_others(reading: ModelStates, before: State, after: State) -> None:
    """Check that the foreign variables change between two states as their step guarantees allow."""
    for guarantee in reading.interface.of(reading.interface.foreign):
        if guarantee.is_step and guarantee_failure(guarantee, reading.program, before, after) is not None:
            raise Unshowable(f"another application breaks {guarantee.label} in the counterexample")


def _others(reading: ModelStates) -> Counterexample:
    """Run a step of another application, which changes what is foreign."""
    before, given, interface = reading.state("before"), reading.state("after"), reading.interface
    foreign = {name for _, name in interface.foreign}
    cells = {**before.store.cells, **{name: given.store.cells[name] for name in foreign}}
    ports = [name for _, name in interface.ports]
    robots = tuple(
        old._replace(ports={**old.ports, **{name: new.ports[name] for name in ports}})
        for old, new in zip(before.robots, given.robots, strict=True)
    )
    after = before._replace(robots=robots, store=before.store._replace(cells=cells))
    _relied_upon(reading, before)
    _kept_by_others(reading, before, after)
    for guarantee in interface.of(interface.foreign):
        if not guarantee.is_step and guarantee_failure(guarantee, reading.program, after, after) is not None:
            raise Unshowable(f"another application breaks {guarantee.label} in the counterexample")
    return _failed_step(reading, before.store, before, after, None, "")


def _guarantee(reading: ModelStates) -> Counterexample:
    """Check a guarantee of first values or after `init`, or check that a step guarantee is reflexive and transitive."""
    obligation = reading.obligation
    before, after = reading.state("before"), reading.state("after")
    if obligation.event == "init":
        before, after, discarded = _ran_init(reading)
        if discarded is not None:
            raise Unshowable(f"no mission begins: init has no result, {discarded.outcome}")
    elif obligation.event == TRANSITIVE:
        first = reading.state("round start")
        if _broken(reading, first, before) is not None or _broken(reading, before, after) is not None:
            raise Unshowable("one of the counterexample's two steps breaks the guarantee")
        before = first
    failed = _broken(reading, before, after)
    if failed is None:
        raise Unshowable("the guarantee holds when the semantics evaluates it")
    return _seen(reading, before.store, before, after, None, failed, "")


def _are_all_true(name: str, program: decl.Program, state: State) -> bool:
    return all(is_true(p, program, state) for p in program.properties if p.name == name and p.kind == "invariant")


def is_true(property_: decl.Property, program: decl.Program, state: State) -> bool:
    """Return whether a property holds in a state. A property without a value does not hold."""
    try:
        return holds_property(property_, program, state)
    except Discarded:
        return False


def _failed_step(
    reading: ModelStates, begun: Store, before: State, after: State, pid: int | None, discarded: str
) -> Counterexample:
    obligation = reading.obligation
    failed = None
    for property_ in reading.program.properties:
        if property_.name == obligation.invariant and property_.kind == "invariant":
            failed = failing_conjunct(property_, reading.program, after)
    if failed is None and not discarded:
        raise Unshowable("the step preserves the invariant when the semantics runs it")
    return _seen(reading, begun, before, after, pid, failed, discarded)


def _seen(
    reading: ModelStates, begun: Store, before: State, after: State, pid: int | None, failed: Conjunct | None,
    discarded: str,
) -> Counterexample:  # fmt: skip
    obligation = reading.obligation
    seen = frozenset(cell.name for cell in obligation.cells)
    line = failed.formula.span.line if failed is not None else obligation.line
    kind, event = obligation.kind, obligation.event
    file = obligation.goal.file if failed is not None and obligation.goal is not None else obligation.file
    return Counterexample(
        obligation.invariant, kind, event, pid, file, line, begun, before, after, failed, discarded, seen
    )


def failing_conjunct(
    property_: decl.Property | decl.Guarantee, program: decl.Program, state: State, temps: Mapping[str, Value] = {}
) -> Conjunct | None:
    """Return the conjunct that makes a property false in a state; None if the property holds.

    `temps`: for a guarantee, the values of its variable before and after a write."""
    view = library(program, len(state.robots), state.params, NOTHING, Budget(), no_port)
    view = view._replace(slots=state.store.slots, cells=state.store.cells, robots=state.robots, temps=temps)
    return _failing_conjunct(property_.formula, view)


def _failing_conjunct(node: ir.Expr, view: StateView) -> Conjunct | None:
    try:
        if holds(node, view):
            return None
    except Discarded:
        return Conjunct(node, dict(view.temps))
    match node:
        case ir.Logic("and", left, right):
            return _failing_conjunct(left, view) or _failing_conjunct(right, view)
        case ir.Quantified("forall", name, domain, body):
            for value in elements(domain, view):
                found = _failing_conjunct(body, view._replace(temps={**view.temps, name: value}))
                if found is not None:
                    return found
            return None
        case _:
            return Conjunct(node, dict(view.temps))


def plain_value(value: Any) -> Any:
    """Return a value in a form that JSON can represent.

    A number that a float cannot represent exactly becomes text."""
    match value:
        case bool() | int() | str():
            return value
        case float():
            return value if math.isfinite(value) else str(value)
        case Fraction():
            return value.numerator if value.denominator == 1 else _float(value)
        case Point(x, y, z):
            return [plain_value(x), plain_value(y), plain_value(z)]
        case RecordValue(_, fields):
            return [plain_value(field) for field in fields]
        case tuple():
            return [plain_value(part) for part in value]
        case bytes():
            return b64encode(value).decode()
        case Pose() | Grid() | Scan() | GridMap() | Opaque():
            return [plain_value(getattr(value, name)) for name in value.__struct_fields__]
        case _:
            return str(value)


def _float(value: Fraction) -> float | str:
    near = float(value) if abs(value) < 10**300 else 0.0
    return near if near == value else str(value)
