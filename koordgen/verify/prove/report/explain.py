"""Explanation of a failed obligation: counterexample, run to the counterexample, suggestion."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, NamedTuple

from koordgen.lang.ir import decl
from koordgen.lang.ir.expr import Expr
from koordgen.lang.node import replace
from koordgen.lang.semantics.deadline import Deadline, OutOfTime, ends
from koordgen.lang.semantics.exact import exact
from koordgen.lang.semantics.step import initial
from koordgen.lang.semantics.values import Value as KoordValue
from koordgen.verify.prove.obligations.generate import obligations
from koordgen.verify.prove.obligations.interface import ALONE, Interface
from koordgen.verify.prove.report.model import Counterexample, run_model, with_values
from koordgen.verify.prove.report.model_reader import ModelReader, Unshowable, flat
from koordgen.verify.prove.report.reach import CounterexampleRun, SearchBounds, run_to
from koordgen.verify.prove.report.strengthen import strengthening, unassumed, with_position_assumptions
from koordgen.verify.prove.smt.obligation import HeadFormula, LabelledFormula, Obligation
from koordgen.verify.prove.smt.solve import CrossCheck, Solver, SolverAnswer
from koordgen.verify.prove.smt.term import REAL, EncodingTooLarge, Term, equals, to_int, to_real

if TYPE_CHECKING:
    from koordgen.verify.prove.smt.solve import ObligationResult

# Numbers of robots for which a counterexample is searched. Small fleets come first because they are easier to read.
FLEETS = (1, 2, 3, 4)
QUERY_SECONDS = 1.0  # limit in seconds for each query to the solver while a failure is explained
SEARCH_SECONDS = 4.0  # limit in seconds for the search for a counterexample that the semantics can run
STRENGTHENING_SECONDS = 1.0  # limit in CPU seconds, including the solver's, for the search for a strengthening


class FailureExplanation(NamedTuple):
    """Reason why an invariant is not proved.

    `counterexample`: a step that violates the invariant; None if no such step can be shown.
    `run`: a run from an initial state to a state in which the invariant is false; None if no run was found. Without a
        run, the counterexample's first state may be unreachable, and the counterexample only shows that the invariant
        is not inductive.
    `unshown`: the reason why no counterexample is shown although the solver reports one.
    `lacking`: conjuncts that would make the invariant inductive.
    `with_defaults`: whether the invariant is proved if the params have their default values.
    `unassumed`: sensors about which the program assumes nothing.
    `supposed`: assumptions about the `unassumed` sensors that, together with `lacking`, prove the invariant.
    `hint`: a sentence about the reason, if the counterexample shows a common one."""

    counterexample: Counterexample | None
    run: CounterexampleRun | None
    unshown: str
    lacking: tuple[str, ...]
    with_defaults: bool = False
    unassumed: tuple[str, ...] = ()
    supposed: tuple[str, ...] = ()
    hint: str = ""


class Explainer:
    """Explainer of failed obligations. `proved` is the program without the invariants that are not PROVED."""

    def __init__(
        self,
        program: decl.Program,
        robots: int | None,
        params: Mapping[str, Expr] | None,
        solver: Solver | CrossCheck,
        proved: decl.Program,
        dropped: frozenset[HeadFormula] = frozenset(),
    ) -> None:
        self.program, self.robots, self.params, self.solver, self.proved = program, robots, params, solver, proved
        self.dropped, self.interface = dropped, ALONE
        self.made: dict[tuple[decl.Program, int, str, HeadFormula | None, Interface], list[Obligation]] = {}

    def explain(
        self, name: str, group: Iterable[ObligationResult], relied: decl.Program, interface: Interface = ALONE
    ) -> FailureExplanation:
        """Explain why obligations of the invariant or guarantee `name` fail.

        `relied`: the program with the invariants that these obligations assumed.
        `interface`: the interface with the guarantees that these obligations assumed."""
        self.interface = interface
        try:
            return self._explained(name, group, relied)
        except EncodingTooLarge as error:
            return FailureExplanation(None, None, f"the search for a counterexample was stopped: {error}", ())

    def _explained(self, name: str, group: Iterable[ObligationResult], relied: decl.Program) -> FailureExplanation:
        failing = [o.obligation for o in group if not o.holds and o.answer.result == "sat"]
        why, shown = "", None
        for obligation in sorted(failing, key=lambda o: o.kind != "base"):
            try:
                shown = self.counterexample(obligation, relied)
                break
            except Unshowable as error:
                why = f"the solver's counterexample cannot be shown: {error}"
        invariant = next((p for p in self.program.properties if p.kind == "invariant" and p.name == name), None)
        if shown is None:
            return FailureExplanation(None, None, why, ())
        if invariant is None:
            hint = overwritten(relied, shown, self.interface)
            return FailureExplanation(shown, None, "", (), self.holds_with_defaults(name, relied), hint=hint)
        if not self.interface.is_alone:  # a run of one application alone is no run of the fleet
            return FailureExplanation(shown, None, "", self.lacking(self.proved, invariant) or ())
        values = shown.before.params
        program = with_values(exact(self.program), {p: v for p, v in values.items() if self.free(p)})
        run = run_to(program, invariant_of(program, name), _values(shown), SearchBounds(), self.robots)
        sensors = unassumed(self.program, invariant) if any(o.kind == "environment" for o in failing) else []
        if sensors:
            more, supposed = with_position_assumptions(self.proved, sensors)
            lacking = self.lacking(more, invariant) if supposed else None
            names = tuple([f"{module.name}.{port.name}" for module, port in sensors])
            return FailureExplanation(shown, run, "", lacking or (), False, names, () if lacking is None else supposed)
        with_defaults = self.holds_with_defaults(name, relied)
        lacking = None if run is not None or with_defaults else self.lacking(self.proved, invariant)
        return FailureExplanation(shown, run, "", lacking or (), with_defaults)

    def holds_with_defaults(self, name: str, relied: decl.Program) -> bool:
        """Return whether the invariant is proved if the params have their default values."""
        free = {p.name: p.default for p in relied.params if self.free(p.name)}
        if not free:
            return False
        made = obligations(
            relied, self.robots, {**(self.params or {}), **free}, "usual", self.dropped, None, self.interface
        )
        own = [o for o in made if o.invariant == name and o.kind != "consistency"]
        return all(self.solver.ask(o, most=QUERY_SECONDS).result == o.expected for o in own)

    def free(self, param: str) -> bool:
        imported = self.interface is not ALONE and "." in param
        return not imported and (self.params is None or param not in self.params)

    def counterexample(self, obligation: Obligation, relied: decl.Program) -> Counterexample:
        """Return a counterexample in the smallest possible fleet.

        Raises Unshowable, with the first reason, if no counterexample can be shown."""
        program = exact(relied)
        reasons: list[str] = []
        until = time.monotonic() + SEARCH_SECONDS
        for robots in (self.robots,) if self.robots is not None else FLEETS:
            for same in self.of(relied, robots, obligation):
                if (same.name, same.kind) != (obligation.name, obligation.kind):
                    continue
                reader = ModelReader(same)
                if time.monotonic() > until:
                    raise Unshowable(
                        f"{reasons[0] if reasons else 'no counterexample found'}, within {SEARCH_SECONDS:g} s"
                    )
                for answer in self.models(same, program, reader):
                    reader.answered(answer.values)
                    try:
                        with ends(Deadline(time.monotonic, until)):
                            return run_model(program, same, reader, robots, self.interface)
                    except Unshowable as error:
                        reasons.append(str(error))
                    except OutOfTime:
                        reasons.append("the run of the counterexample takes too long")
        raise Unshowable(reasons[0] if reasons else f"no counterexample found for 1 to {FLEETS[-1]} robots")

    def models(self, obligation: Obligation, program: decl.Program, reader: ModelReader) -> Iterator[SolverAnswer]:
        """Yield models of a failed obligation, the most readable models first.

        The first query asks for whole numbers and the params' default values. The second query asks for whole numbers,
        the third query for arbitrary values."""
        reals = [t for cell in obligation.cells for t in cell.terms if t.sort is REAL]
        whole = reader.short() + [equals(to_real(to_int(t)), t) for t in dict.fromkeys(reals)]
        with_defaults = list(_usual(obligation, program))
        for more in dict.fromkeys([(*with_defaults, *whole), tuple(whole), ()]):
            facts = tuple([LabelledFormula("readable values", term, "", 0) for term in more])
            asked = replace(obligation, facts=(*obligation.facts, *facts), logic="ALL" if more else obligation.logic)
            answer = self.solver.ask(asked, reader.wanted(), most=QUERY_SECONDS)
            if answer.result == "sat":
                yield answer

    def of(self, program: decl.Program, robots: int, failed: Obligation) -> list[Obligation]:
        """Return all obligations of one event, for a fleet of `robots` robots.

        A failed formula of a loop's head was dropped by the first proof. The obligations returned here assume it."""
        key = (program, robots, failed.event, failed.at, self.interface)
        if key not in self.made:
            dropped = self.dropped - {failed.at}
            self.made[key] = obligations(program, robots, self.params, "most", dropped, failed.event, self.interface)
        return self.made[key]

    def lacking(self, proved: decl.Program, invariant: decl.Property) -> tuple[str, ...] | None:
        """Return conjuncts that, with the proved invariants, prove `invariant`; None if none are found."""
        until = time.process_time() + STRENGTHENING_SECONDS
        solving = 0.0
        base = replace(proved, properties=(*proved.properties, invariant))

        def proves(program: decl.Program, names: frozenset[str]) -> frozenset[str]:
            nonlocal solving
            bad: set[str] = set()
            # Ask about any number of robots: an invariant that is proved for any number holds for this number, too. The
            # solver decides these obligations faster.
            for obligation in obligations(program, None, self.params, "usual", self.dropped, None, self.interface):
                if obligation.invariant in names - bad and obligation.kind != "consistency":
                    if time.process_time() + solving > until:
                        return frozenset()
                    answer = self.solver.ask(obligation, most=QUERY_SECONDS)
                    solving += answer.seconds
                    if answer.result != obligation.expected:
                        bad.add(obligation.invariant)
            return names - bad

        if proved is not self.proved and proves(base, frozenset({invariant.name})):
            return ()
        return strengthening(base, invariant.name, proves) or None


def overwritten(program: decl.Program, shown: Counterexample, interface: Interface) -> str:
    """Return a sentence if a plain event breaks a guarantee by a value that it computed from a stale one.

    The event read the variable at the round's start. Since then another robot has written it, and the event undoes
    that write."""
    event = next((e for e in program.events if e.name == shown.event), None)
    wanted = next((g for g in interface.guarantees if g.label == shown.invariant), None)
    if event is None or event.lock is not None or wanted is None or wanted.key[0] != "cell":
        return ""
    name = wanted.key[1]
    if not wanted.is_step or shown.begun.cells[name] == shown.before.store.cells[name]:
        return ""
    return (
        f"another robot may have written {name} since the round's start, and {event.name} overwrites its value: "
        f"write {name} under `atomic`"
    )


def _usual(obligation: Obligation, program: decl.Program) -> Iterator[Term]:
    """Yield the formulas "this param has its default value"."""
    # The program's variables are left out, because their initial values may have no exact representation.
    values = initial(replace(program, shared=(), locals=(), modules=()), 1).params
    for cell in obligation.cells:
        parts = flat(values.get(cell.name))
        if cell.robot is None and len(parts) == len(cell.terms):
            yield from (equals(term, part) for term, part in zip(cell.terms, parts, strict=True))


def invariant_of(program: decl.Program, name: str) -> decl.Property:
    return next(p for p in program.properties if p.kind == "invariant" and p.name == name)


def _values(shown: Counterexample) -> list[KoordValue]:
    """Return the values of all ports (sensors and commands) of all robots in a counterexample."""
    states = (shown.before, shown.after)
    return [value for state in states for robot in state.robots for value in robot.ports.values()]
