"""A counterexample as a trace (see docs/reference/trace.md), which simulators and replayers read."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
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
    Pose,
    RobotName,
    Round,
    Shared,
    TraceRecord,
    Violation,
    plain,
)
from koordgen.runtime.values.points import Point
from koordgen.verify.prove.report.explain import Explanation
from koordgen.verify.prove.report.model import Conjunct, Counterexample, plain_value
from koordgen.verify.prove.report.reach import Moment, no_way
from koordgen.verify.prove.report.spell import spelled

UNMOVED = ("", "(environment)")  # moments at which no robot did anything

# What a callable port may say: to a robot, by what its sensors say, the port, the arguments.
Answers = Callable[[int, Mapping[str, Any], str, tuple[Any, ...]], tuple[Any, ...]]


class About(NamedTuple):
    """What a run was made with: the hash of the very program ("" where it has no numbers that robots have), the params
    that it was given, what its callable ports may have said, its extern functions."""

    program_hash: str = ""
    given: tuple[str, ...] = ()
    answers: Answers = lambda pid, sensors, port, args: (no_way(pid, port, args),)
    externs: Mapping[str, Callable[..., Value]] = {}


def trace(program: decl.Program, told: Explanation, about: About) -> str:
    """JSON lines: a header, then each step as a round of each robot, and where the robots are where a sensor tells; a
    last one tells what is violated. One second stands for each round. Numbers that are no float are fractions, as text.
    """
    found = told.counterexample
    if found is None:
        return ""
    failed: Conjunct | None
    culprit = None
    if told.run is not None:
        moments, failed = told.run.moments, told.run.failed
    else:
        moments, failed = _pair(found), found.failed
        if found.discarded and found.pid is not None:
            moments, culprit = moments[:1], (found.pid, found.event)
    line = failed.formula.span.line if failed is not None else found.line
    detail = f"false: {spelled(failed.formula)}" if failed is not None else found.discarded
    return run_trace(program, moments, (found.invariant, line, detail), about, culprit)


def run_trace(
    program: decl.Program, moments: tuple[Moment, ...], violated: tuple[str, int, str] | None, about: About,
    culprit: tuple[int, str] | None = None,
) -> str:  # fmt: skip
    """A run; `violated`: the property that its last moment violates, its line in the program, and how. `culprit` is the
    robot, and its event, that would come next and has no result, where that is what is wrong."""
    lines: list[TraceRecord] = [_header(program, moments, about), *_steps(program, moments, about)]
    if violated is not None:
        name, line, detail = violated
        robots = tuple(f"robot{pid}" for pid in range(len(moments[-1].state.robots)))
        pid, event = culprit or (LEFT_OUT, LEFT_OUT)
        t, place = float(moments[-1].round), f"{program.path}:{line}"
        lines.append(Violation(t, "property", robots, detail, name, place, LEFT_OUT, program.name, pid, event))
    return "".join(json.dumps(plain(line)) + "\n" for line in lines)


def _pair(found: Counterexample) -> tuple[Moment, ...]:
    """An event, or init, or a step of the environment."""
    if found.kind == "base":
        return Moment(found.before, "", None, 0), Moment(found.after, "init", None, 0)
    if found.kind == "environment":
        return Moment(found.before, "", None, 1), Moment(found.after, "(environment)", None, 1)
    return Moment(found.before, "", None, 1), Moment(found.after, found.event, found.pid, 1)


def _header(program: decl.Program, moments: tuple[Moment, ...], about: About) -> Header:
    state = moments[0].state
    return Header(
        format=FORMAT,
        app=program.name,
        program_hash=about.program_hash,
        delta=1.0,
        seed=0,
        robots=tuple([RobotName(f"robot{pid}", pid, "proof") for pid in range(len(state.robots))]),
        duration=float(moments[-1].round),
        shared=tuple([Shared(v.name, v.kind, str(v.type)) for v in program.shared]),
        applications=(program.name,),
        counterexample="step" if moments[0].round else "run",
        params=_plain(state.params),
        given=about.given,
    )


def _steps(program: decl.Program, moments: tuple[Moment, ...], about: About) -> Iterator[Pose | Round]:
    sensors = {f"{m.name}.{p.name}" for m in program.modules for p in m.ports if p.direction == "sensor"}
    for index, moment in enumerate(moments):
        state = moment.state
        calls: Mapping[int, Any] = _calls(program, moments, index, about)
        for pid, robot in enumerate(state.robots):
            acted = moment.pid in (None, pid)
            slots = {name: values[pid] for name, values in state.store.slots.items()}
            place = next((robot.ports[name] for name in positions(program)), None)
            if isinstance(place, Point):
                position = (float(place.x), float(place.y), float(place.z))
                yield Pose(pid, position, 0.0, LEFT_OUT, float(moment.round))
            yield Round(
                round=moment.round,
                event=moment.event if acted and moment.event not in UNMOVED else None,
                skipped=None if acted else "another robot's step",
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
                t=float(moment.round),
                pid=pid,
                application=program.name,
                step=moment.event or "the beginning",
            )


Calls = list[tuple[str, list[Any], Any]]  # port, arguments, answer, in JSON


def _calls(program: decl.Program, moments: tuple[Moment, ...], index: int, about: About) -> dict[int, Calls]:
    """What callable ports were asked in a step, and said, by the robot that asked."""
    moment = moments[index]
    if moment.event in UNMOVED or not any(p.direction == "callable" for m in program.modules for p in m.ports):
        return {}
    acting = range(len(moment.state.robots)) if moment.pid is None else (moment.pid,)
    return {pid: _asked(program, moments, index, about, pid) for pid in acting}


def _asked(program: decl.Program, moments: tuple[Moment, ...], index: int, about: About, pid: int) -> Calls:
    """The step is run again with all that may have been answered, until it does what it did."""
    moment, before = moments[index], moments[index - 1].state
    begun = next(m.state for m in reversed(moments[:index]) if m.round < moment.round or m is moments[0])
    pending: list[tuple[int, ...]] = [()]
    for scripted in pending:  # grows meanwhile
        script = _Script(about, before.robots[pid].ports, scripted)
        done = _again(program, moment.event, before, begun, pid, World(about.externs, script.answer))
        if isinstance(done, Writes):
            after = applied(program, before, Step(pid, moment.event, done))
            others = moment.pid is None or after.store == moment.state.store
            if others and after.robots[pid] == moment.state.robots[pid]:
                return script.calls
        pending += script.others()
    return []


def _again(
    program: decl.Program, name: str, before: State, begun: State, pid: int, world: World
) -> Writes | Discarded | None:
    """A step of a round that began with the store of `begun`; None where it cannot be run."""
    event = next((e for e in program.events if e.name == name), None)
    seen = before if event is None or event.lock is not None else before._replace(store=begun.store)
    try:
        if event is not None and not enabled(program, event, seen, pid, world):
            return None
        return execute(program, event.effect if event else program.init, seen, pid, world)
    except (Discarded, NoMeaning):
        return None


class _Script:
    """Answers the callable ports in one run of a step: to the k-th question the `scripted[k]`-th of what may be said,
    beyond it the first; equal questions the same."""

    def __init__(self, about: About, sensors: Mapping[str, Any], scripted: tuple[int, ...]) -> None:
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
        """The scripts that first say something else at a question that this one did not foresee."""
        for place in range(len(self._scripted), len(self._options)):
            begin = (*self._scripted, *([0] * (place - len(self._scripted))))
            yield from ((*begin, other) for other in range(1, self._options[place]))


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    return {name: plain_value(value) for name, value in values.items()}
