"""A counterexample as a trace, format koord-trace/1 (see docs/sim.md): what simulators and replayers read."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

from koordgen.ir import decl
from koordgen.prove.explain import Explanation
from koordgen.prove.model import Conjunct, Counterexample, plain_value
from koordgen.prove.reach import Moment, no_way
from koordgen.prove.spell import spelled
from koordgen.runtime.values import Point
from koordgen.semantics.eval import Discarded
from koordgen.semantics.exec import NoMeaning
from koordgen.semantics.state import State, World
from koordgen.semantics.step import enabled, execute
from koordgen.semantics.values import Value

FORMAT = "koord-trace/1"
UNMOVED = ("", "(environment)")  # moments at which no robot did anything

# What a callable port says: to a robot, by what its sensors say, the port, the arguments.
Answer = Callable[[int, Mapping[str, Any], str, tuple[Any, ...]], Any]


class About(NamedTuple):
    """What a run was made with: the hash of the very program ("" where it has no numbers that robots have), what its
    callable ports said, its extern functions."""

    program_hash: str = ""
    answer: Answer = lambda pid, sensors, port, args: no_way(pid, port, args)
    externs: Mapping[str, Callable[..., Value]] = {}


def trace(program: decl.Program, told: Explanation, about: About) -> str:
    """JSON lines: a header, then each step as a round of each robot, and where the robots are where a sensor tells; a
    last one tells what is violated. One second stands for each round. Numbers that are no float are fractions, as text.
    """
    found = told.counterexample
    if found is None:
        return ""
    failed: Conjunct | None
    if told.run is not None:
        moments, failed = told.run.moments, told.run.failed
    else:
        moments, failed = _pair(found), found.failed
    line = failed.formula.span.line if failed is not None else found.line
    detail = f"false: {spelled(failed.formula)}" if failed is not None else found.discarded
    return run_trace(program, moments, (found.invariant, line, detail), about)


def run_trace(
    program: decl.Program, moments: tuple[Moment, ...], violated: tuple[str, int, str] | None, about: About,
    culprit: tuple[int, str] | None = None,
) -> str:  # fmt: skip
    """A run; `violated`: the property that its last moment violates, its line in the program, and how. `culprit` is the
    robot, and its event, that would come next and has no result, where that is what is wrong."""
    lines = [_header(program, moments, about.program_hash), *_steps(program, moments, about)]
    if violated is not None:
        name, line, detail = violated
        end = {
            "kind": "violation",
            "t": float(moments[-1].round),
            "what": "property",
            "robots": [f"robot{pid}" for pid in range(len(moments[-1].state.robots))],
            "detail": detail,
            "name": name,
            "line": f"{program.path}:{line}",
        }
        lines.append(end | ({"pid": culprit[0], "event": culprit[1]} if culprit else {}))
    return "".join(json.dumps(line) + "\n" for line in lines)


def _pair(found: Counterexample) -> tuple[Moment, ...]:
    return Moment(found.before, "", None, 1), Moment(found.after, found.event, found.pid, 1)


def _header(program: decl.Program, moments: tuple[Moment, ...], program_hash: str) -> dict[str, Any]:
    state = moments[0].state
    return {
        "kind": "header",
        "format": FORMAT,
        "app": program.name,
        "program_hash": program_hash,
        "counterexample": "step" if moments[0].round else "run",  # from any state, or from an initial one
        "delta": 1.0,
        "seed": 0,
        "duration": float(moments[-1].round),
        "robots": [{"name": f"robot{pid}", "pid": pid, "target": "proof"} for pid in range(len(state.robots))],
        "params": _plain(state.params),
        "shared": [{"name": v.name, "kind": v.kind, "type": str(v.type)} for v in program.shared],
    }


def _steps(program: decl.Program, moments: tuple[Moment, ...], about: About) -> Iterator[dict[str, Any]]:
    sensors = {f"{m.name}.{p.name}" for m in program.modules for p in m.ports if p.direction == "sensor"}
    for index, moment in enumerate(moments):
        state = moment.state
        calls = _calls(program, moments, index, about)
        for pid, robot in enumerate(state.robots):
            acted = moment.pid in (None, pid)
            slots = {name: values[pid] for name, values in state.store.slots.items()}
            place = next((v for n, v in robot.ports.items() if n.endswith(".position") and isinstance(v, Point)), None)
            if place is not None:
                position = [float(x) for x in (place.x, place.y, place.z)]
                yield {"kind": "pose", "t": float(moment.round), "pid": pid, "position": position, "yaw": 0.0}
            record = {
                "kind": "round",
                "t": float(moment.round),
                "pid": pid,
                "round": moment.round,
                "event": moment.event if acted and moment.event not in UNMOVED else None,
                "skipped": None if acted else "another robot's step",
                "step": moment.event or "the beginning",
                "sensors": _plain({n: v for n, v in robot.ports.items() if n in sensors}),
                "shared": _plain({**slots, **state.store.cells}),
                "actuators": _plain({n: v for n, v in robot.ports.items() if n not in sensors}),
                "locals": _plain(robot.locals),
                "stopped": robot.stopped,
            }
            yield record | ({"calls": calls[pid]} if calls.get(pid) else {})


def _calls(
    program: decl.Program, moments: tuple[Moment, ...], index: int, about: About
) -> dict[int, list[tuple[str, list[Any], Any]]]:
    """What callable ports were asked in a step, and said, by the robot that asked: the step is run once more."""
    moment = moments[index]
    asked: dict[int, list[tuple[str, list[Any], Any]]] = {}
    if moment.event in UNMOVED or not any(p.direction == "callable" for m in program.modules for p in m.ports):
        return asked
    before = moments[index - 1].state
    begun = next(m.state for m in reversed(moments[:index]) if m.round < moment.round or m is moments[0])

    def answer(pid: int, port: str, args: tuple[Value, ...]) -> Value:
        said: Value = about.answer(pid, before.robots[pid].ports, port, args)
        asked.setdefault(pid, []).append((port, [plain_value(arg) for arg in args], plain_value(said)))
        return said

    world = World(about.externs, answer)
    for pid in range(len(before.robots)) if moment.pid is None else (moment.pid,):
        try:
            _again(program, moment.event, before, begun, pid, world)
        except (Discarded, NoMeaning):
            continue
    return asked


def _again(program: decl.Program, name: str, before: State, begun: State, pid: int, world: World) -> None:
    event = next((e for e in program.events if e.name == name), None)
    seen = before if event is None or event.lock is not None else before._replace(store=begun.store)
    if event is not None:
        enabled(program, event, seen, pid, world)
    execute(program, event.effect if event else program.init, seen, pid, world)


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    return {name: plain_value(value) for name, value in values.items()}
