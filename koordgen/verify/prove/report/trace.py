"""Trace of a counterexample (docs/reference/trace.md), as input for simulators and replayers."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from koordgen.lang.ir import decl
from koordgen.lang.ir.ports import positions
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.exec import NoMeaning, Writes
from koordgen.lang.semantics.state import State, World
from koordgen.lang.semantics.step import Step, applied, enabled, execute
from koordgen.lang.semantics.values import Value
from koordgen.runtime.trace.schema import (
    FORMAT,
    LEFT_OUT,
    Header,
    PoseRecord,
    RobotName,
    Round,
    SharedVariable,
    TraceRecord,
    Violation,
    plain,
)
from koordgen.runtime.values.points import Point
from koordgen.verify.prove.report.explain import FailureExplanation
from koordgen.verify.prove.report.koord_text import to_koord
from koordgen.verify.prove.report.model import Conjunct, Counterexample, plain_value
from koordgen.verify.prove.report.reach import RunState, no_path

UNMOVED = ("", "(environment)")  # steps in which no robot acts
NOBODY = -1  # pid of a step in another application

# Function with the arguments: pid, values of the robot's sensors, callable port, arguments of the call. It returns the
# possible answers to the call.
Answers = Callable[[int, Mapping[str, Any], str, tuple[Any, ...]], tuple[Any, ...]]


class RunOrigin(NamedTuple):
    """Origin of a run: facts about the program and its environment that a trace records or needs.

    `program_hash`: the program's hash; "" if the run contains numbers that robots cannot represent.
    `given`: the params given on the command line.
    `answers`: returns the possible answers of callable ports.
    `externs`: the implementations of extern functions."""

    program_hash: str = ""
    given: tuple[str, ...] = ()
    answers: Answers = lambda pid, sensors, port, args: (no_path(pid, port, args),)
    externs: Mapping[str, Callable[..., Value]] = {}


def trace(program: decl.Program, explanation: FailureExplanation, about: RunOrigin) -> str:
    """Return the trace of a counterexample as JSON lines; empty if there is no counterexample.

    The records are a header, the steps and the violation. For each step, every robot has one round record. If a sensor
    measures a robot's position, the record is preceded by the position. Each round takes one second. A number that is
    not a float is written as text, as a fraction."""
    found = explanation.counterexample
    if found is None:
        return ""
    failed: Conjunct | None
    culprit = None
    if explanation.run is not None:
        run_states, failed = explanation.run.run_states, explanation.run.failed
    else:
        run_states, failed = _pair(found), found.failed
        if found.discarded and found.pid is not None:
            run_states, culprit = run_states[:1], (found.pid, found.event)
    line = failed.formula.span.line if failed is not None else found.line
    detail = f"false: {to_koord(failed.formula)}" if failed is not None else found.discarded
    return run_trace(program, run_states, (found.invariant, line, detail), about, culprit)


def run_trace(
    program: decl.Program, run_states: tuple[RunState, ...], violated: tuple[str, int, str] | None, about: RunOrigin,
    culprit: tuple[int, str] | None = None,
) -> str:  # fmt: skip
    """Return the trace of a run as JSON lines.

    `violated`: the property that is false in the last state, its line in the program, and details; None if no property
        is false.
    `culprit`: the robot and its next event, if the failure is that this event has no result; otherwise None."""
    lines: list[TraceRecord] = [_header(program, run_states, about), *_steps(program, run_states, about)]
    if violated is not None:
        name, line, detail = violated
        robots = tuple(f"robot{pid}" for pid in range(len(run_states[-1].state.robots)))
        pid, event = culprit or (LEFT_OUT, LEFT_OUT)
        t, place = float(run_states[-1].round), f"{program.path}:{line}"
        lines.append(Violation(t, "property", robots, detail, name, place, LEFT_OUT, program.name, pid, event))
    return json_lines(lines)


def json_lines(lines: Iterable[TraceRecord]) -> str:
    """Return the text of a trace with these records."""
    return "".join(json.dumps(plain(line)) + "\n" for line in lines)


def _pair(found: Counterexample) -> tuple[RunState, ...]:
    """Return the states before and after an event, an `init` or a step of the environment."""
    if found.kind == "base":
        return RunState(found.before, "", None, 0), RunState(found.after, "init", None, 0)
    if found.kind == "environment":
        return RunState(found.before, "", None, 1), RunState(found.after, "(environment)", None, 1)
    return RunState(found.before, "", None, 1), RunState(found.after, found.event, found.pid, 1)


def _header(program: decl.Program, run_states: tuple[RunState, ...], about: RunOrigin) -> Header:
    state = run_states[0].state
    return Header(
        format=FORMAT,
        app=program.name,
        program_hash=about.program_hash,
        delta=1.0,
        seed=0,
        robots=tuple([RobotName(f"robot{pid}", pid, "proof") for pid in range(len(state.robots))]),
        duration=float(run_states[-1].round),
        shared=tuple([SharedVariable(v.name, v.kind, str(v.type)) for v in program.shared]),
        applications=(program.name,),
        counterexample="step" if run_states[0].round else "run",
        params=_plain(state.params),
        given=about.given,
    )


def _steps(program: decl.Program, run_states: tuple[RunState, ...], about: RunOrigin) -> Iterator[PoseRecord | Round]:
    for index in range(len(run_states)):
        yield from step_records(program, run_states, index, about)


def step_records(
    program: decl.Program, run_states: tuple[RunState, ...], index: int, about: RunOrigin, application: str = "",
    places: Sequence[int] = (),
) -> Iterator[PoseRecord | Round]:  # fmt: skip
    """Yield the records of one step of a run: for each robot its position, if it is measured, and its round.

    If the pid of the step is NOBODY, the step is one of another application.
    `application`: the name of the application; by default that of the program. `places`: the pid in the records for
    each pid in the application; by default the same."""
    sensors = {f"{m.name}.{p.name}" for m in program.modules for p in m.ports if p.direction == "sensor"}
    run_state = run_states[index]
    state = run_state.state
    calls: Mapping[int, Any] = _calls(program, run_states, index, about)
    idle = "another application's step" if run_state.pid == NOBODY else "another robot's step"
    place_of = places or range(len(state.robots))
    for pid, robot in enumerate(state.robots):
        acted = run_state.pid in (None, pid)
        slots = {name: values[pid] for name, values in state.store.slots.items()}
        place = next((robot.ports[name] for name in positions(program)), None)
        if isinstance(place, Point):
            position = (float(place.x), float(place.y), float(place.z))
            yield PoseRecord(place_of[pid], position, 0.0, LEFT_OUT, float(run_state.round))
        yield Round(
            round=run_state.round,
            event=run_state.event if acted and run_state.event not in UNMOVED else None,
            skipped=None if acted else idle,
            fault=LEFT_OUT,
            late=LEFT_OUT,
            sensors=_plain({n: v for n, v in robot.ports.items() if n in sensors}),
            locals=_plain(robot.locals),
            shared=_plain({**slots, **state.store.cells}),
            actuators=_plain({n: v for n, v in robot.ports.items() if n not in sensors}),
            copy=LEFT_OUT,
            calls=calls.get(pid) or LEFT_OUT,
            violated=LEFT_OUT,
            stopped=robot.stopped,
            restored=LEFT_OUT,
            clock_bound=LEFT_OUT,
            counters=LEFT_OUT,
            time=LEFT_OUT,
            t=float(run_state.round),
            pid=place_of[pid],
            application=application or program.name,
            step=run_state.event or "the beginning",
        )


Calls = list[tuple[str, list[Any], Any]]  # (callable port, arguments, answer) of each call, as JSON values


def _calls(program: decl.Program, run_states: tuple[RunState, ...], index: int, about: RunOrigin) -> dict[int, Calls]:
    """Return one step's calls of callable ports, with their answers, by the pid of the calling robot."""
    run_state = run_states[index]
    if (
        run_state.event in UNMOVED
        or run_state.pid == NOBODY
        or not any(p.direction == "callable" for m in program.modules for p in m.ports)
    ):
        return {}
    acting = range(len(run_state.state.robots)) if run_state.pid is None else (run_state.pid,)
    return {pid: _asked(program, run_states, index, about, pid) for pid in acting}


def _asked(program: decl.Program, run_states: tuple[RunState, ...], index: int, about: RunOrigin, pid: int) -> Calls:
    """Return the calls of one robot in a step, found by running the step again.

    The run does not record the answers. So the step is run with every combination of possible answers, until its effect
    is the same as in the run."""
    run_state, before = run_states[index], run_states[index - 1].state
    begun = next(m.state for m in reversed(run_states[:index]) if m.round < run_state.round or m is run_states[0])
    pending: list[tuple[int, ...]] = [()]
    for scripted in pending:  # the body of this loop appends to `pending`
        script = _Script(about, before.robots[pid].ports, scripted)
        done = _again(program, run_state.event, before, begun, pid, World(about.externs, script.answer))
        if isinstance(done, Writes):
            after = applied(program, before, Step(pid, run_state.event, done))
            others = run_state.pid is None or after.store == run_state.state.store
            if others and after.robots[pid] == run_state.state.robots[pid]:
                return script.calls
        pending += script.others()
    return []


def _again(
    program: decl.Program, name: str, before: State, begun: State, pid: int, world: World
) -> Writes | Discarded | None:
    """Run one step again, in a round that began with the shared store of `begun`.

    Returns None if the step cannot be run."""
    event = next((e for e in program.events if e.name == name), None)
    seen = before if event is None or event.lock is not None else before._replace(store=begun.store)
    try:
        if event is not None and not enabled(program, event, seen, pid, world):
            return None
        return execute(program, event.effect if event else program.init, seen, pid, world)
    except (Discarded, NoMeaning):
        return None


class _Script:
    """Answers to callable ports in one run of a step.

    The call number k gets the possible answer number `scripted[k]`. Calls beyond the script get the first possible
    answer. Equal calls get equal answers."""

    def __init__(self, about: RunOrigin, sensors: Mapping[str, Any], scripted: tuple[int, ...]) -> None:
        self._about, self._sensors, self._scripted = about, sensors, scripted
        self._given: dict[str, Value] = {}
        self._options: list[int] = []
        self.calls: Calls = []

    def answer(self, pid: int, port: str, args: tuple[Value, ...]) -> Value:
        key = repr((port, args))
        if key not in self._given:
            place = len(self._options)
            options = self._about.answers(pid, self._sensors, port, args)
            said = options[self._scripted[place] if place < len(self._scripted) else 0]
            self._options.append(len(options))
            self._given[key] = said
            self.calls.append((port, [plain_value(arg) for arg in args], plain_value(said)))
        return self._given[key]

    def others(self) -> Iterator[tuple[int, ...]]:
        """Yield longer scripts. Each new script selects another answer than the first for one further call."""
        for place in range(len(self._scripted), len(self._options)):
            begin = (*self._scripted, *([0] * (place - len(self._scripted))))
            yield from ((*begin, other) for other in range(1, self._options[place]))


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    return {name: plain_value(value) for name, value in values.items()}
