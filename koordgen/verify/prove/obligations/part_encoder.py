"""Proof problem, and the encoder of a program part with its assumptions."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from itertools import islice, product
from typing import Literal

from koordgen.lang.ir import decl, stmt
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.ports import clears
from koordgen.lang.ir.tree import Part, walk
from koordgen.lang.ir.types import Type
from koordgen.verify.prove.encode.context import ProofContext, symbol
from koordgen.verify.prove.encode.encoder import Scope
from koordgen.verify.prove.encode.function import Functions
from koordgen.verify.prove.encode.loop import conjuncts, written
from koordgen.verify.prove.encode.quantifier import domain as domain_of
from koordgen.verify.prove.encode.scope import FleetScope, RobotScope, UnknownAnswer
from koordgen.verify.prove.encode.state import Key, SymbolicState, UpdatedState, cleared, declared, sensors
from koordgen.verify.prove.encode.stmt import LoopHead
from koordgen.verify.prove.encode.values import Val, build, shape
from koordgen.verify.prove.obligations.interface import ALONE, Interface
from koordgen.verify.prove.obligations.loops import INIT, LoopInvariants
from koordgen.verify.prove.smt import term as t
from koordgen.verify.prove.smt.obligation import HeadFormula, LabelledFormula, StateCell, StateName
from koordgen.verify.prove.smt.term import Term

# Level of detail: the amount of facts that are added to a proof. "little" suffices for most proofs. "most" adds all
# facts, which takes solvers long. Counterexamples are searched with "usual" or "most" only.
Detail = Literal["little", "usual", "most"]
Trigger = ir.Call | ir.ExternCall | ir.Builtin
# Largest number of value combinations at which an axiom is instantiated, when axioms are checked for contradictions.
CHOICES = 16
# Largest number of robots that are named by numbers: PAIRED if formulas quantify over pairs of robots, otherwise
# UNROLLED.
UNROLLED, PAIRED = 20, 4


class ProofProblem:
    """Proof problem: a program, its number of robots, and its fixed params.

    `robots`: the number of robots; None for any number.
    `params`: the values of fixed params. All other params are arbitrary.
    `detail`: the amount of facts that are added.
    `dropped`: formulas that are known not to hold at heads of loops.
    `interface`: the interface to the other applications of the fleet."""

    def __init__(
        self, program: decl.Program, robots: int | None, params: Mapping[str, ir.Expr] | None, detail: Detail,
        dropped: frozenset[HeadFormula] = frozenset(), interface: Interface = ALONE,
    ) -> None:  # fmt: skip
        self.detail, self.interface = detail, interface.with_commands(program)
        pairs = any(_pairs(p.formula) for p in program.properties)
        self.unrolled = robots is not None and (robots <= (PAIRED if pairs else UNROLLED))
        self.program, self.robots, self.params = program, robots, params or {}
        self.types = declared(program)
        self.sensors, self.cleared = sensors(program), cleared(program)
        self.invariants = [p for p in program.properties if p.kind == "invariant"]
        self.axioms = [(p, *_triggers(p.formula)) for p in program.properties if p.kind == "axiom"]
        self.initially = [p for p in program.properties if p.kind == "initially"]
        self.mentions = {p.name: frozenset(mentioned(p.formula)) for p in self.invariants}
        numbered = robots if self.unrolled else None
        self.loops = LoopInvariants(program, self.mentions, self.params, numbered, dropped)

    def changed(self, event: decl.Event) -> set[Key]:
        """Return the variables that an event may change, including the sensors that its commands clear."""
        keys = {key for key in written(event.effect) if key[0] != "temp"}
        commanded = clears(self.program)
        cleared = {("port", sensor) for kind, name in keys if kind == "port" for sensor in commanded.get(name, ())}
        return keys | cleared

    def touched(self, keys: Collection[Key]) -> list[decl.Property]:
        """Return the invariants that mention at least one of the variables `keys`.

        An event that writes only these variables preserves all other invariants (frame condition), so the other
        invariants have no obligation for the event."""
        return [p for p in self.invariants if not self.mentions[p.name].isdisjoint(keys)]


class PartEncoder:
    """Encoder of one part of a program. The part's obligations share the facts of the encoder."""

    def __init__(self, problem: ProofProblem, thorough: bool = False) -> None:
        """Begin to encode a part. `thorough` adds all facts about distances, for every detail level."""
        self.thorough = thorough or problem.detail == "most"
        program = problem.program
        self.problem = problem
        self.brief = problem.detail == "little"
        self.context = ProofContext(program, problem.robots, problem.unrolled)
        self.params: dict[str, Val] = {}
        # id of an axiom's trigger -> number of calls at which the axiom has been instantiated
        self.looked: dict[int, int] = {}
        self.functions = Functions(self.context, self.params, self.assume_at_head, self.brief and not thorough)
        self.encoder = self.functions.encoder
        self.encoder.geometry.brief = self.brief and not thorough
        for param in program.params:
            self.params[param.name] = self._param(param)
        for property_ in problem.initially:
            self.rigid(property_.formula)

    def _param(self, param: decl.Param) -> Val:
        fixed = self.problem.params.get(param.name)
        if fixed is not None:
            return self.encoder.value(fixed, FleetScope(_Nowhere()))
        name = symbol(param.name)
        return build(param.type, iter([t.constant(name + suffix, sort) for suffix, sort in shape(param.type)]))

    # Formulas that the proof assumes

    def rigid(self, formula: ir.Expr) -> None:
        """Assume, in all states, the parts of an `initially` formula that read only params.

        Params never change, so such a part holds in every state."""
        for part in conjuncts(formula):
            if not any(isinstance(n, (ir.LocalOf, ir.PortOf, ir.SlotRead, ir.SlotsRead, ir.SharedRead, ir.Ids))
                       for n in walk(part)):  # fmt: skip
                with self.context.about("initially", part.span.line):
                    self.assume(part, FleetScope(_Nowhere()))

    def holds(
        self, properties: Iterable[decl.Property], state: SymbolicState, guard: Term = t.TRUE, when: str = ""
    ) -> None:
        """Assume properties of a state, under the condition `guard`.

        `when` is appended to the label of each fact."""
        for property_ in properties:
            label = f"{property_.kind} {property_.name}".strip() + when
            with self.context.about(label, property_.span.line):
                self.assume(property_.formula, FleetScope(state), guard)

    def assume(self, formula: ir.Expr, scope: Scope, guard: Term = t.TRUE) -> None:
        """Add a formula as a fact under the condition `guard`.

        A universal formula is registered now and instantiated later."""
        match formula:
            case ir.Logic("and", left, right):
                self.assume(left, scope, guard)
                self.assume(right, scope, guard)
            case ir.Quantified("forall", name, domain, body):
                over = domain_of(self.encoder, domain, scope, body, name)
                temps = dict(scope.temps)

                def instance(value: Val, within: Term) -> None:
                    kept, scope.temps = scope.temps, {**temps, name: value}
                    with self.context.grant(value if isinstance(domain, ir.Ids) else None):
                        self.assume(body, scope, t.and_(guard, within))
                    scope.temps = kept

                def each(index: Term) -> Term:
                    within = over.inside(index)
                    if within is not t.FALSE:
                        instance(over.element(index), within)
                    return t.TRUE

                for value in over.listed or ():
                    instance(value, t.TRUE)
                if over.listed is None:
                    self.context.for_all(each, over.robots, over.places)
            case _:
                self.context.fact(t.implies(guard, self.encoder.defined(formula, scope)))

    def assume_at_head(self, head: LoopHead) -> None:
        """Assume the formulas at a loop's head, for all program points after the head.

        The formulas hold before each iteration and after the last iteration.
        SOUND: the formulas are assumed only for pids of robots. At the mission's start, `init` is encoded for int terms
        that may not be pids. Nothing may be assumed about such an encoding."""
        loops, place, own = self.problem.loops, head.turn, head.turn.frame.pid
        in_event = place.frame.now is not None
        reached = t.and_(place.reached, self.context.within(own)) if in_event else place.reached
        with (
            self.context.known_at(place.position),
            self.context.outermost(),
            self.context.grant(own if in_event else None),
        ):
            for at, formula in loops.stated(head.loop):
                with self.context.about(f"loop invariant of {at.owner}", formula.span.line):
                    self.assume(formula, place.frame, reached)
            for at, property_ in loops.candidates(head.loop):
                label = f"invariant {property_.name} at the loop in line {head.loop.span.line}"
                with self.context.about(label, property_.span.line):
                    formula, scope = self.at_head(at, property_, place.frame.state())
                    self.assume(formula, scope, reached)

    def at_head(self, at: HeadFormula, property_: decl.Property, state: UpdatedState) -> tuple[ir.Expr, FleetScope]:
        """Return an invariant as it is assumed at a loop's head, with the scope for its names.

        In an event, the invariant is stated about the state that the fleet would have if the event ended at the head.
        In `init`, the invariant is stated about the acting robot only, since other robots may not have run their `init`
        yet."""
        scope, formula = FleetScope(state), property_.formula
        while at.owner == INIT and isinstance(formula, ir.Quantified) and formula.kind == "forall":
            if not isinstance(formula.domain, ir.Ids):
                break
            scope.temps[formula.name] = state.own
            formula = formula.body
        return formula, scope

    def ports(self, before: SymbolicState, after: SymbolicState) -> None:
        """Assume each module's assumptions about one step of the environment, for every robot."""
        for module in self.problem.program.modules:
            for assumption in module.assumptions:
                with self.context.about(f"assume of {module.name}", assumption.span.line):
                    self._each_robot(assumption, before, after)

    def _each_robot(self, assumption: decl.Assumption, before: SymbolicState, after: SymbolicState) -> None:
        parts = [p for p in conjuncts(assumption.formula) if not any(isinstance(n, ir.PortCall) for n in walk(p))]

        def instance(robot: Term) -> Term:
            inside = t.TRUE if self.context.indices.get(robot) else self.context.within(robot)
            for part in parts:
                self.assume(part, RobotScope(before, after, robot, {}), inside)
            return t.TRUE

        if parts:
            self.context.for_all(instance)

    def answered(self, port: ir.PortCall, args: tuple[Val, ...], answer: Val, pid: Term, state: SymbolicState) -> None:
        """Assume the program's assumptions about a callable port's answer, for the arguments of one call."""
        name = f"{port.module}.{port.port}"
        for module in self.problem.program.modules:
            for assumption in module.assumptions if module.name == port.module else ():
                for part in conjuncts(assumption.formula):
                    self._of_answer(part, port, args, RobotScope(state, state, pid, {(name, args): answer}))

    def _of_answer(self, part: ir.Expr, port: ir.PortCall, args: tuple[Val, ...], scope: RobotScope) -> None:
        """Assume one formula about a port's answer, if the formula is about the time of the call.

        A formula that reads primed ports or actuators is about a later time, when these ports may have other values."""
        calls = [(call, free) for call, free in decl.handed(part) if call.port == port.port]
        reads = [n for n in walk(part) if isinstance(n, ir.PortRead)]
        ports = {("port", f"{n.module}.{n.port}") for n in reads}
        known = self.problem.sensors - self.problem.interface.ports
        if not calls or not ports <= known or any(n.primed for n in reads):
            return
        call, free = calls[0]
        if len(call.args) != len(args):
            return
        scope.temps = {goal.name: args[place] for place, goal in free.items()}
        with self.context.about(f"assume of {port.module}", part.span.line):
            try:
                self.context.fact_if_reached(self.encoder.defined(part, scope))
            except (UnknownAnswer, KeyError):
                return  # the formula also calls the port with other arguments, whose answers are unknown

    def any_answers(self, state: SymbolicState) -> None:
        """Assume that each callable port with assumptions gives an answer, for arbitrary arguments."""
        for module in self.problem.program.modules:
            for assumption in module.assumptions:
                for call, _ in decl.handed(assumption.formula):
                    args = tuple([self.context.any("goal", arg.type) for arg in call.args])
                    answer = self.context.any(f"{call.module}.{call.port}", call.type)
                    self.answered(call, args, answer, t.integer(0), state)

    def any_axioms(self) -> None:
        """Instantiate each axiom at two arbitrary values of each type.

        All axioms use the same values, so that a contradiction between axioms becomes visible.
        SOUND: an axiom holds for all values, so it holds for the chosen values."""
        values: dict[Type, tuple[Val, Val]] = {}
        for axiom, free, _ in self.problem.axioms:
            for type_ in free.values():
                if type_ not in values:
                    values[type_] = self.context.any("some", type_), self.context.any("other", type_)
            for choice in islice(product(*[values[type_] for type_ in free.values()]), CHOICES) if free else ():
                scope = FleetScope(_Nowhere())
                scope.temps = dict(zip(free, choice, strict=True))
                with self.context.about(f"axiom {axiom.name}", axiom.span.line):
                    self.context.fact(self.encoder.defined(axiom.formula, scope))

    def any_contracts(self) -> None:
        """Assume that a call of each extern function has a result, for arbitrary arguments."""
        for function in self.problem.program.externs:
            args = tuple([self.context.any(p.name.split("@")[0], p.type) for p in function.parameters])
            result = self.encoder.apply(function.name, symbol(function.name), args, function.result)
            required, ensured = self.functions.contract(function, args, result)
            with self.context.about(f"contract of {function.name}", function.span.line):
                for formula in required:
                    self.context.fact(formula)
                for formula, line in ensured:
                    self.context.fact(formula, line=line)

    def is_assumed_of_calls(self, fact: LabelledFormula) -> bool:
        """Return whether a fact is an assumption about a called function or a called port."""
        return fact.label.startswith(("contract of ", "axiom ", "assume of "))

    def axioms(self) -> None:
        """Instantiate the axioms of spec functions at the arguments of calls."""
        for axiom, free, triggers in self.problem.axioms:
            with self.context.about(f"axiom {axiom.name}", axiom.span.line):
                if not free:
                    self.assume(axiom.formula, FleetScope(_Nowhere()))
                for trigger in triggers:
                    self._axiom(axiom, trigger)

    def _axiom(self, axiom: decl.Property, trigger: Trigger) -> None:
        """Instantiate an axiom at each call of its trigger that is new since the last instantiation."""
        met = self.encoder.calls.get(trigger.name, [])
        done = self.looked.get(id(trigger), 0)
        self.looked[id(trigger)] = len(met)
        for args in met[done : len(met)]:
            scope = FleetScope(_Nowhere())
            places = zip(trigger.args, args, strict=True)
            scope.temps = {a.name: v for a, v in places if isinstance(a, ir.TempRead)}
            self.context.fact(self.encoder.defined(axiom.formula, scope))

    def close(self) -> tuple[LabelledFormula, ...]:
        """Return all facts of the part. Call this method after all goals have been encoded.

        Lemmas about distances introduce new distances, which need lemmas again. Lemmas are added in up to two rounds,
        or in up to three rounds if `thorough`."""
        for _ in range(3 if self.thorough else 2):
            many = len(self.context.facts)
            self.context.instantiate()
            self.axioms()
            self.encoder.geometry.lemmas(self.problem.detail == "most")
            if len(self.context.facts) == many:
                break
        return tuple(self.context.facts)

    def cells(self, states: Iterable[tuple[StateName, SymbolicState]]) -> tuple[StateCell, ...]:
        """Return the variables of all robots in the part, as terms whose values a counterexample shows.

        With detail "little", the result is empty."""
        if self.brief:
            return ()
        lists, found = self.encoder.lists, []
        for param in self.problem.program.params:
            found.append(StateCell(param.name, None, param.type, lists.leaves(self.params[param.name]), "before"))
        robots = [index for index, known in self.context.indices.items() if known or self.context.robots is None]
        for state_name, state in states:
            for key, type_ in self.problem.types.items():
                for robot in robots[:1] if key[0] == "cell" else robots:
                    owner = None if key[0] == "cell" else robot
                    found.append(StateCell(key[1], owner, type_, lists.leaves(state.of(key, robot)), state_name))
        return tuple(found)


class _Nowhere:
    """Placeholder for a state, used for formulas that read only params. Reading a variable is an error."""

    types: Mapping[Key, Type] = {}
    state_name = ""

    def of(self, key: Key, robot: Term) -> Val:
        raise AssertionError(f"a formula that may read only params reads {key}")


def _triggers(axiom: ir.Expr) -> tuple[dict[str, Type], list[Trigger]]:
    """Return the free names of an axiom, and its triggers.

    A trigger is a call in the axiom whose arguments include all free names."""
    free = decl.free(axiom)
    calls = [n for n in walk(axiom) if isinstance(n, (ir.Call, ir.ExternCall, ir.Builtin))] if free else []
    return free, [n for n in calls if free.keys() <= {a.name for a in n.args if isinstance(a, ir.TempRead)}]


def _pairs(formula: ir.Expr, around: bool = False) -> bool:
    """Return whether a formula nests one quantifier over robots inside another."""
    for node in walk(formula):
        if isinstance(node, ir.Quantified) and isinstance(node.domain, ir.Ids):
            return around or _pairs(node.body, True)
    return False


def mentioned(formula: Part) -> Iterator[Key]:
    """Yield the variables that a formula or a block reads or writes."""
    for node in walk(formula):
        match node:
            case ir.LocalOf(name) | ir.LocalRead(name) | stmt.LocalPlace(name):
                yield "local", name
            case ir.PortOf(module, port) | ir.PortRead(module, port) | stmt.PortPlace(module, port):
                yield "port", f"{module}.{port}"
            case ir.SlotRead(name) | ir.SlotsRead(name) | stmt.OwnSlot(name):
                yield "slot", name
            case ir.SharedRead(name) | stmt.SharedPlace(name):
                yield "cell", name
            case _:
                pass
