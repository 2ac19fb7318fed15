"""Solver driver: one solver process for all queries, within limits of time and memory.

The answer `unsat` proves an obligation, so it is never assumed. If the output is anything but exactly one answer (an
error, a crash, garbage, no output), the result is "unknown", with the reason. Then the process is killed, and the next
query starts a new process. Measured: z3's executable is ready within 17 ms, z3's Python module within 65 ms, and a
query takes 1 to 2 ms.
"""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import Literal, NamedTuple, Self

from koordgen.lang.diagnostics import InternalError
from koordgen.verify.prove.smt.axis_parallel import axis_parallel
from koordgen.verify.prove.smt.obligation import Obligation
from koordgen.verify.prove.smt.process import Process, ProcessEnded, memory_limit
from koordgen.verify.prove.smt.sexpr import ModelValue, Unreadable, values
from koordgen.verify.prove.smt.smtlib import script, together
from koordgen.verify.prove.smt.term import TRUE, Term, not_

# Limit in seconds for each query of a batch. A query that exceeds this limit is asked again alone, with its full limit.
BRIEF = 0.5
MARK = "koordgen-batch"
WORDS: frozenset[str] = frozenset(("sat", "unsat", "unknown"))


class Batch:
    """Queries that one solver process has received and not answered yet, in the order of sending."""

    def __init__(self, solver: Solver) -> None:
        self.solver = solver
        # (obligation, number of its goals, time of sending)
        self.sent: list[tuple[Obligation, int, float]] = []

    def add(self, group: Sequence[Obligation]) -> None:
        """Send the obligations of one group. Raises SolverFailed."""
        parts = [self.solver.parts(obligation) for obligation in group]
        head, goals = together(group, parts)
        asked = [f'(push)\n{goal}(check-sat)\n(echo "{MARK}")\n(pop)\n' for each in goals for goal in each]
        self.solver.send(self.solver.preamble(group[0].logic, False, False, BRIEF) + head + "".join(asked))
        now = time.monotonic()
        self.sent += [(obligation, len(each), now) for obligation, each in zip(group, parts, strict=True)]

    def answers(self) -> dict[int, tuple[SatResult, float]]:
        """Return id of an obligation -> its result, and the seconds until the result arrived.

        If several answers arrive at once, the first answer gets all the seconds. The result is empty if the output
        contains anything besides answers. Raises SolverFailed."""
        count = sum(goals for _, goals, _ in self.sent)
        output, came = self.solver.remaining_output(MARK, BRIEF * count)
        words, marks = output[::2], output[1::2]
        if len(output) != 2 * count or len(came) != count or not WORDS.issuperset(words) or set(marks) != {MARK}:
            return {}
        found: dict[int, tuple[SatResult, float]] = {}
        at, last = 0, 0.0
        for obligation, goals, sent in self.sent:
            own = words[at : at + goals]
            at += goals
            result: SatResult = "sat" if "sat" in own else "unknown" if "unknown" in own else "unsat"
            found[id(obligation)] = result, max(0.0, came[at - 1] - max(last, sent))
            last = came[at - 1]
        return found


SatResult = Literal["sat", "unsat", "unknown"]
LINEAR = frozenset(("QF_UFLIA", "QF_UFLIRA"))
# z3's first answer takes 10 ms longer than later answers, so an empty query is sent first.
WARM = '(push)\n(check-sat)\n(pop)\n(echo "koordgen-0")\n'
GRACE = 1.0  # seconds that a solver may exceed a query's limit before it is killed
MOST_BYTES = 1 << 24  # size of the largest answer that is read, in bytes


class SolverMissing(Exception):
    """Raised if the solver is not installed. The message names the searched directories."""


class Limits(NamedTuple):
    """Limits of a solver.

    `query`: seconds for one query.
    `total`: seconds for all queries of a command.
    `memory`: megabytes of the solver's memory."""

    query: float = 10.0
    total: float = 60.0
    memory: int = 2048


class SolverAnswer(NamedTuple):
    """Answer of a solver about one obligation.

    `reason`: explains an unknown result and names a remedy.
    `values`: if the result is `sat`, the values of the wanted terms, in the order of the terms.
    `core`: if requested, the indices in `facts` of facts that already contradict one another."""

    result: SatResult
    seconds: float
    reason: str = ""
    values: tuple[ModelValue, ...] = ()
    core: tuple[int, ...] = ()


class SolverFailed(Exception):
    """Raised if the solver process can no longer be used. The message gives the reason."""


def command_of(name: str, memory: int) -> list[str]:
    """Return the command that starts a solver with at most `memory` megabytes. Raises SolverMissing."""
    folders = [os.path.dirname(sys.executable), *os.environ.get("PATH", "").split(os.pathsep)]
    places = [os.path.join(folder, name) for folder in folders if folder]
    found = next((place for place in places if os.path.isfile(place) and os.access(place, os.X_OK)), None)
    if found and name == "z3":
        return [found, "-in", f"-memory:{memory}"]
    if found:
        return [found, "--incremental", "--lang=smt2", "-q"]
    from importlib.util import find_spec

    if name == "cvc5" and find_spec("cvc5"):
        return [sys.executable, "-P", os.path.join(os.path.dirname(__file__), "cvc5_driver.py")]
    raise SolverMissing(f"solver {name} not found beside {sys.executable} or on the PATH")


class Solver:
    """Solver process, which the method `start` or the first query starts.

    `command`: replaces the default command."""

    def __init__(self, name: str, limits: Limits | None = None, command: Sequence[str] | None = None) -> None:
        self.name = name
        self.limits = limits or Limits()
        self.command = list(command) if command is not None else command_of(name, self.limits.memory)
        self.spent = 0.0
        self._process: Process | None = None
        self._asked = 0
        self._warming = False
        self._left = ""  # command that undoes the settings of the previous query
        self._timeout = 0  # timeout that the solver has now, in milliseconds; 0 if unknown

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def start(self) -> None:
        """Start the solver, which then loads while the caller does other work."""
        if self._process is not None:
            return
        try:
            self._process = Process(self.command, memory_limit(self.limits.memory))
        except OSError as error:
            raise SolverMissing(f"{self.command[0]}: {error.strerror}") from None
        self._left, self._timeout = "", 0
        self._process.unsent = WARM.encode() if self.name == "z3" else b""
        with suppress(ProcessEnded):  # if the process has ended, the next query reports the reason
            self._process.exchange(0.0)
        self._warming = self.name == "z3"

    def stop(self) -> None:
        """Kill the process without waiting for its exit. The method `end` waits."""
        if self._process is not None:
            self._process.kill()

    def end(self) -> None:
        """Kill the process, if one runs, and wait for its exit."""
        process, self._process = self._process, None
        if process is not None:
            process.end()

    def ask(
        self, obligation: Obligation, wanted: Sequence[Term] = (), core: bool = False, most: float = math.inf
    ) -> SolverAnswer:
        """Ask whether the facts and the negation of the goal are satisfiable together.

        `most`: limit in seconds for this query. The solver's limit per query applies if it is lower. Raises
        SolverMissing.
        """
        if obligation.too_large:
            return SolverAnswer("unknown", 0.0, obligation.too_large)
        began = time.monotonic()
        left = self.limits.total - self.spent
        if left <= 0:
            return SolverAnswer(
                "unknown", 0.0, f"the {self.limits.total:g} s for all queries are used up; try a longer --timeout"
            )
        limit = min(self.limits.query, left, most)
        try:
            answer = self._answered(obligation, wanted, core, limit)
        except SolverFailed as broken:
            self.end()
            answer = SolverAnswer("unknown", 0.0, str(broken))
        seconds = time.monotonic() - began
        self.spent += seconds
        return answer._replace(seconds=seconds)

    def _answered(self, obligation: Obligation, wanted: Sequence[Term], core: bool, limit: float) -> SolverAnswer:
        self.start()
        until = time.monotonic() + limit + GRACE
        self._warm(until)
        if not wanted and not core and len(self.parts(obligation)) > 1:
            return self._refuted(obligation, limit, until)
        text, names = script(obligation, wanted, core)
        output = self._query(self.preamble(obligation.logic, core, bool(names), limit) + text + "(check-sat)\n", until)
        match output:
            case "unsat":
                return SolverAnswer("unsat", 0.0, core=self._core(until) if core else ())
            case "sat":
                return SolverAnswer("sat", 0.0, values=self._values(names, until))
            case "unknown":
                return SolverAnswer("unknown", 0.0, self._why(limit, until))
            case _:
                raise SolverFailed(f"{self.name} answered neither sat nor unsat: {_short(output)}{_exhausted(output)}")

    def ask_all(self, groups: Iterable[Sequence[Obligation]]) -> list[tuple[Obligation, SolverAnswer]]:
        """Answer many obligations. Each answer has the same meaning as an answer of `ask`.

        The obligations of one group share most of their facts. z3 receives a group in one batch, and works on the batch
        while the caller encodes the next group. In the batch, a nonlinear consistency obligation has its stricter form
        (axis_parallel.py). An obligation that z3 leaves undecided in the batch is asked again alone. Raises
        SolverMissing."""
        self.start()
        batch = Batch(self)
        found: list[tuple[Obligation, Obligation]] = []  # obligation, and the form that is sent in the batch
        for group in groups:
            pairs = [(o, axis_parallel(o) or o) for o in group]
            found += pairs
            sent = [form for _, form in pairs]
            apt = sent and all(o.logic in LINEAR and not o.too_large for o in sent)
            if self.name == "z3" and apt and self._process is not None:
                try:
                    batch.add(sent)
                except SolverFailed:
                    self.end()
        answers: dict[int, SolverAnswer] = {}
        if self._process is not None and batch.sent:
            try:
                answers = {key: SolverAnswer(*output) for key, output in batch.answers().items()}
            except SolverFailed:
                self.end()
        self.spent += sum(answer.seconds for answer in answers.values())
        return [(o, self._decided(o, form, answers.get(id(form))) or self.ask(o)) for o, form in found]

    @staticmethod
    def _decided(obligation: Obligation, form: Obligation, answer: SolverAnswer | None) -> SolverAnswer | None:
        """Return the answer about an obligation that follows from the answer about its form in a batch, if any does."""
        if answer is None or answer.result == "unknown" or (form is not obligation and answer.result != "sat"):
            return None
        return answer

    def parts(self, obligation: Obligation) -> list[Term]:
        """Return the formulas that must be refuted to prove an obligation.

        If robots are named by numbers, a goal has many conjuncts. z3 refutes the conjuncts separately in a third of the
        time that it needs to refute all conjuncts together."""
        if obligation.goal is None:
            return [TRUE]
        numbered = obligation.robots is not None and len(obligation.conjuncts) > 1
        if numbered and self.name == "z3" and obligation.logic in LINEAR:
            return [not_(part.term) for part in obligation.conjuncts]
        return [not_(obligation.goal.term)]

    def _refuted(self, obligation: Obligation, limit: float, until: float) -> SolverAnswer:
        parts = self.parts(obligation)
        text, (goals,) = together([obligation], [parts])
        asked = "".join([f"(push)\n{goal}(check-sat)\n(pop)\n" for goal in goals])
        output = self._query(self.preamble(obligation.logic, False, False, limit) + text + asked, until).split("\n")
        if len(output) != len(parts) or not {"sat", "unsat", "unknown"}.issuperset(output):
            raise SolverFailed(
                f"{self.name} answered neither sat nor unsat: {_short(' '.join(output))}{_exhausted(output[0])}"
            )
        if "sat" in output:
            return SolverAnswer("sat", 0.0)
        if "unknown" in output:
            return SolverAnswer(
                "unknown", 0.0, f"{self.name} found no answer within {limit:g} s; try a longer --timeout"
            )
        return SolverAnswer("unsat", 0.0)

    def preamble(self, logic: str, core: bool, model: bool, limit: float) -> str:
        """Return the commands that begin a query and undo the previous query.

        Linear queries to z3 run inside a scope (push, pop), which saves 2 to 10 ms per query. All other queries begin
        with a reset, so that the solver can choose the tactic for their logic."""
        milliseconds = max(1, int(limit * 1000))
        if self.name == "z3" and logic in LINEAR and not core:
            before, self._left = self._left, "(pop)\n"
            changed = f"(set-option :timeout {milliseconds})\n" if milliseconds != self._timeout else ""
            self._timeout = milliseconds
            return f"{before}{changed}(push)\n"
        self._left, self._timeout = "(reset)\n", 0
        option = "timeout" if self.name == "z3" else "tlimit-per"
        asked = ["(reset)", f"(set-option :{option} {milliseconds})"]
        asked += ["(set-option :produce-unsat-cores true)"] * core + ["(set-option :produce-models true)"] * model
        return "\n".join([*asked, f"(set-logic {logic})", ""])

    def _values(self, names: list[str], until: float) -> tuple[ModelValue, ...]:
        if not names:
            return ()
        output = self._query(f"(get-value ({' '.join(names)}))\n", until)
        try:
            return tuple(values(output, len(names)))
        except Unreadable as error:
            raise SolverFailed(f"{self.name} answered sat with an unusable model: {error}") from None

    def _core(self, until: float) -> tuple[int, ...]:
        output = self._query("(get-unsat-core)\n", until).strip("()").split()
        return tuple(sorted(int(name.removeprefix("fact!")) for name in output if name.startswith("fact!")))

    def _why(self, limit: float, until: float) -> str:
        output = (
            self._query("(get-info :reason-unknown)\n", until).removeprefix("(:reason-unknown").rstrip(")").strip(' "')
        )
        if "timeout" in output or "cancel" in output:
            return f"{self.name} found no answer within {limit:g} s; try a longer --timeout"
        return f"{self.name} cannot decide the obligation: {_short(output) or 'no reason given'}{_exhausted(output)}"

    def _warm(self, until: float) -> None:
        if self._warming:
            self._warming = False
            self._output_before("koordgen-0", until)

    def _query(self, text: str, until: float) -> str:
        """Send commands and return the solver's output for these commands. Raises SolverFailed."""
        self._asked += 1
        end = f"koordgen-{self._asked}"
        self.send(f'{text}(echo "{end}")\n')
        return self._output_before(end, until)

    def remaining_output(self, mark: str, seconds: float) -> tuple[list[str], list[float]]:
        """Wait for all output since the last query.

        Returns the lines of the output, and the arrival time of each mark in the output. Raises SolverFailed."""
        assert self._process is not None
        self._asked += 1
        end = f"koordgen-{self._asked}"
        self.send(f'(echo "{end}")\n')
        limit = min(seconds, self.limits.query, self.limits.total - self.spent)
        place = self._waited(end, time.monotonic() + limit + GRACE)
        came = self._process.came(mark)
        lines = [line.strip('"\r') for line in self._process.receive(place).split("\n")]
        if self._warming:
            self._warming = False
            lines = lines[2:] if lines[:2] == ["sat", "koordgen-0"] else []
        return lines, came

    def send(self, text: str) -> None:
        """Send commands to the solver. Raises SolverFailed."""
        assert self._process is not None
        try:
            self._process.send(text)
        except ProcessEnded:
            raise SolverFailed(self._obituary()) from None

    def _output_before(self, end: str, until: float) -> str:
        """Return the output before the word `end`, which an `(echo)` command prints. Raises SolverFailed."""
        assert self._process is not None
        return self._process.receive(self._waited(end, until))

    def _waited(self, end: str, until: float) -> int:
        """Send pending commands and read output until the solver has echoed the word `end`.

        Returns the position of the word in the output. Raises SolverFailed."""
        process = self._process
        assert process is not None
        while (ended := _ended(process.read, end.encode())) is None:
            left = until - time.monotonic()
            try:
                going = left > 0 and process.exchange(left)
            except ProcessEnded:
                raise SolverFailed(self._obituary()) from None
            if not going or len(process.read) > MOST_BYTES:
                raise SolverFailed(f"{self.name} did not answer in time and was killed; try a longer --timeout")
        return ended

    def _obituary(self) -> str:
        assert self._process is not None
        process, self._process = self._process, None
        status = process.wait()
        words = _short(process.read.decode(errors="replace"))
        how = f"was killed by signal {-status}" if status < 0 else f"ended with status {status}"
        hint = _exhausted(words) or (
            f" (its memory is limited to {memory_limit(self.limits.memory)} MB)"
            if status in (-11, -9, -6, 101, 127)
            else ""
        )
        return f"{self.name} {how} during a query{f', with the output: {words}' if words else ''}{hint}"


def _ended(output: bytes, end: bytes) -> int | None:
    """Return the position before the last line, if the last line is the word `end`; otherwise None.

    Solvers may put the word in quotes."""
    if not output.endswith(b"\n"):
        return None
    start = output.rfind(b"\n", 0, len(output) - 1) + 1
    return max(0, start - 1) if output[start:].strip(b"\r\n").strip(b'"') == end else None


def _exhausted(output: str) -> str:
    return " (its memory is limited)" if "memory" in output or "bad_alloc" in output else ""


def _short(text: str) -> str:
    flat = " ".join(text.split())
    return flat if len(flat) <= 160 else f"{flat[:157]}..."


class CrossCheck:
    """Two solvers that receive the same queries.

    If the answers of the solvers contradict each other, an InternalError is raised."""

    def __init__(self, solvers: Sequence[Solver]) -> None:
        self.solvers = tuple(solvers)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for solver in self.solvers:
            solver.end()

    def start(self) -> None:
        for solver in self.solvers:
            solver.start()

    def stop(self) -> None:
        for solver in self.solvers:
            solver.stop()

    def ask(
        self, obligation: Obligation, wanted: Sequence[Term] = (), core: bool = False, most: float = math.inf
    ) -> SolverAnswer:
        """Return the first answer that is not unknown.

        Raises InternalError if one solver answers sat and the other solver answers unsat."""
        answers = [solver.ask(obligation, wanted, core, most) for solver in self.solvers]
        decided = [answer for answer in answers if answer.result != "unknown"]
        if len({answer.result for answer in decided}) > 1:
            told = ", ".join(f"{s.name} {a.result}" for s, a in zip(self.solvers, answers, strict=True))
            raise InternalError(f"solvers contradict each other about {obligation.name}: {told}")
        chosen = decided[0] if decided else answers[0]
        return chosen._replace(seconds=sum(a.seconds for a in answers))

    def ask_all(self, groups: Iterable[Sequence[Obligation]]) -> list[tuple[Obligation, SolverAnswer]]:
        return [(obligation, self.ask(obligation)) for group in groups for obligation in group]


def solver_of(name: str, limits: Limits) -> Solver | CrossCheck:
    """Return the solver z3 or cvc5, or both for a cross-check. Raises SolverMissing."""
    return CrossCheck([Solver(one, limits) for one in ("z3", "cvc5")]) if name == "both" else Solver(name, limits)


class ObligationResult(NamedTuple):
    """Obligation with the solver's answer."""

    obligation: Obligation
    answer: SolverAnswer

    @property
    def holds(self) -> bool:
        return self.answer.result == self.obligation.expected
