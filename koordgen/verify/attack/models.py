"""States for an attack, which the SMT solver finds: the PROVED invariants and the guard of an event hold in them.

The formula for the solver encodes only the state before a step, never the step itself. So a mistake in the encoding of
steps cannot exclude the state that would reveal the mistake. The solver's states are not trusted: before the attack
uses a state, `judge.py` evaluates the invariants in the state.
"""

from __future__ import annotations

from random import Random

from koordgen.lang.ir import decl
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.types import MapOf, RecordType, Sized, TupleOf, Type
from koordgen.lang.ir.types import Sequence as SequenceType
from koordgen.lang.node import replace
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.exact import NotExact
from koordgen.lang.semantics.state import State
from koordgen.verify.prove.encode.context import ProofContext
from koordgen.verify.prove.encode.scope import FleetScope
from koordgen.verify.prove.encode.state import ArbitraryState
from koordgen.verify.prove.encode.values import Val
from koordgen.verify.prove.obligations.part_encoder import PartEncoder, ProofProblem
from koordgen.verify.prove.report.model import ModelStates
from koordgen.verify.prove.report.model_reader import ModelReader, Unshowable
from koordgen.verify.prove.smt import term as t
from koordgen.verify.prove.smt.obligation import LabelledFormula, Obligation
from koordgen.verify.prove.smt.solve import CrossCheck, Solver, SolverMissing
from koordgen.verify.prove.smt.term import Term

QUERY = 2.0  # time limit of one query to the solver, in seconds
NUDGES = 3  # largest number of random conditions that a query adds, so that the solver returns a different state
NUMBERS = (-1, 0, 1, 2, 3, 7)


class Models:
    """Source of states of one program, which the SMT solver finds.

    `program`: the program; the verdict on each of its invariants is PROVED.
    `exact`: the same program with exact numbers.
    `params`: values of params that are fixed.
    `why`: reason why the last search found no state."""

    def __init__(
        self, program: decl.Program, exact: decl.Program, params: dict[str, ir.Expr], solver: Solver | CrossCheck,
        random: Random,
    ) -> None:  # fmt: skip
        self.program, self.exact, self.params, self.solver, self.random = program, exact, params, solver, random
        # (event name, number of robots) -> encoded invariants and guard; None if the encoding is too large
        self.asked: dict[tuple[str, int], _Hypotheses | None] = {}
        self.why = ""
        self.waited = 0.0  # seconds spent waiting for the solver
        t.forget()

    def state(self, event: decl.Event | None, robots: int, most: float) -> State | None:
        """Search for a state with `robots` robots in which the guard of `event` holds for some robot.

        If `event` is None, only the invariants must hold. One query takes at most `most` seconds. Returns None if no
        state is found; then the attribute `why` is the reason."""
        key = event.name if event is not None else "", robots
        if key not in self.asked:
            t.count_anew()
            try:
                self.asked[key] = _Hypotheses(self._hypotheses(event, robots))
            except t.EncodingTooLarge as error:
                self.asked[key] = None
                self.why = f"the assumptions before the step cannot be encoded: {error}"
        asked = self.asked[key]
        if asked is None:
            return None
        for more in (self._nudges(asked), ()):
            found = self._answered(asked, more, robots, min(QUERY, most))
            if found is not None:
                return found
        asked.useless = True
        return None

    def _answered(self, asked: _Hypotheses, more: tuple[Term, ...], robots: int, most: float) -> State | None:
        if asked.useless:
            return None
        facts = tuple(
            [LabelledFormula("condition on the state to find", term, "", 0) for term in (*asked.reader.short(), *more)]
        )
        query = replace(asked.obligation, facts=(*asked.obligation.facts, *facts))
        try:
            answer = self.solver.ask(query, asked.reader.wanted(), most=most)
            self.waited += answer.seconds
            if answer.result != "sat":
                said = "no state satisfies" if answer.result == "unsat" else "the solver found no state that satisfies"
                self.why = f"{said} the invariants and the guard, in a fleet of {robots}"
                return None
            asked.reader.answered(answer.values)
            return ModelStates(self.exact, asked.obligation, asked.reader, robots).state("before")
        except (Unshowable, SolverMissing, NotExact, Discarded) as error:
            self.why = f"no step can be run from the solver's state: {error}"
            return None

    def _nudges(self, asked: _Hypotheses) -> tuple[Term, ...]:
        """Return random conditions on a few variables of a state, so that the solver's next state is different."""
        parts = [p for p in asked.parts if p.sort in (t.INT, t.REAL, t.BOOL)]
        if not parts:
            return ()
        chosen = [self.random.choice(parts) for _ in range(self.random.randint(1, NUDGES))]
        return tuple([self._nudge(part, asked) for part in dict.fromkeys(chosen)])

    def _nudge(self, part: Term, asked: _Hypotheses) -> Term:
        if part.sort == t.BOOL:
            return part if self.random.random() < 0.5 else t.not_(part)
        number = self.random.choice(NUMBERS)
        wanted = t.equals(part, t.integer(number) if part.sort == t.INT else t.real(number))
        return wanted if self.random.random() < 0.7 else t.not_(wanted)

    def _hypotheses(self, event: decl.Event | None, robots: int) -> Obligation:
        """Encode the conditions on the state before a step: the invariants, and the guard of `event` for one robot."""
        part_encoder = PartEncoder(ProofProblem(self.program, robots, self.params, "usual"))
        context, problem = part_encoder.context, part_encoder.problem
        now = ArbitraryState(context, problem.types)
        if event is not None:
            scope = _Acting(now, context, context.acting("pid"))
            with context.about(f"guard of {event.name}", event.guard.span.line):
                context.fact(part_encoder.encoder.term(event.guard, scope))
        part_encoder.holds(problem.invariants, now)
        cells = tuple([cell for cell in part_encoder.cells([("before", now)]) if _is_readable(cell.type)])
        facts = part_encoder.close()
        traits = 0
        for fact in facts:
            traits |= fact.term.traits
        logic = f"QF_UF{'N' if traits & t.NONLINEAR else 'L'}{'IRA' if traits & t.REALS else 'IA'}"
        name = event.name if event is not None else "environment"
        return Obligation(
            f"attack-{name}", "consistency", "", name, self.program.path, 1, logic, facts, None, "sat", (), cells,
            robots, (),
        )  # fmt: skip


class _Acting(FleetScope):
    """Scope in which an event's guard is encoded: the variables of one robot at the start of a round.

    A call of a port has an arbitrary result."""

    def __init__(self, state: ArbitraryState, context: ProofContext, robot: Term) -> None:
        super().__init__(state)
        self.context, self.pid = context, robot

    def local(self, name: str) -> Val:
        return self.state.of(("local", name), self.pid)

    def port(self, name: str, primed: bool) -> Val:
        return self.state.of(("port", name), self.pid)

    def ask(self, node: ir.PortCall, args: tuple[Val, ...]) -> Val:
        return self.context.any(f"{node.module}.{node.port}", node.type)


def _is_readable(type_: Type) -> bool:
    """Return whether values of a type can be read from the solver's answer.

    In a state from the solver, a variable of any other type has its initial value."""
    match type_:
        case RecordType(_, fields):
            return all(_is_readable(field) for _, field in fields)
        case TupleOf(items):
            return all(map(_is_readable, items))
        case SequenceType(name, element):
            return name in ("List", "Queue") and _is_readable(element)
        case Sized(name):
            return name == "string"
        case _:
            return not isinstance(type_, MapOf)


class _Hypotheses:
    """Encoded conditions on a state (invariants, guard), and the reader of the solver's answers.

    `useless`: True if even a query without random conditions found no state, so more queries are useless."""

    def __init__(self, obligation: Obligation) -> None:
        self.obligation = obligation
        self.reader = ModelReader(obligation)
        self.parts = list(dict.fromkeys([term for cell in obligation.cells for term in cell.terms]))
        self.useless = False
