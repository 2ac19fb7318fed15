"""A counterexample as a trace, format koord-trace/1 (see docs/sim.md): what simulators and replayers read."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from koordgen.ir import decl
from koordgen.prove.explain import Explanation
from koordgen.prove.model import Conjunct, Counterexample, plain_value
from koordgen.prove.reach import Moment
from koordgen.prove.spell import spelled
from koordgen.runtime.values import Point

FORMAT = "koord-trace/1"


def trace(program: decl.Program, told: Explanation) -> str:
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
    return run_trace(program, moments, found.invariant, line, detail)


def run_trace(program: decl.Program, moments: tuple[Moment, ...], name: str, line: int, detail: str) -> str:
    """A run whose last moment violates the property of that name, at a line of the program."""
    where = {"robots": [f"robot{pid}" for pid in range(len(moments[-1].state.robots))], "detail": detail,
             "name": name, "line": f"{program.path}:{line}"}  # fmt: skip
    end = {"kind": "violation", "t": float(moments[-1].round), "what": "property", **where}
    lines = [_header(program, moments), *_steps(program, moments), end]
    return "".join(json.dumps(line) + "\n" for line in lines)


def _pair(found: Counterexample) -> tuple[Moment, ...]:
    return Moment(found.before, "", None, 1), Moment(found.after, found.event, found.pid, 1)


def _header(program: decl.Program, moments: tuple[Moment, ...]) -> dict[str, Any]:
    state = moments[0].state
    return {
        "kind": "header",
        "format": FORMAT,
        "app": program.name,
        "program_hash": "",  # no run of robots, and so no bundle
        "delta": 1.0,
        "seed": 0,
        "duration": float(moments[-1].round),
        "robots": [{"name": f"robot{pid}", "pid": pid, "target": "proof"} for pid in range(len(state.robots))],
        "params": _plain(state.params),
        "shared": [{"name": v.name, "kind": v.kind, "type": str(v.type)} for v in program.shared],
    }


def _steps(program: decl.Program, moments: tuple[Moment, ...]) -> Iterator[dict[str, Any]]:
    sensors = {f"{m.name}.{p.name}" for m in program.modules for p in m.ports if p.direction == "sensor"}
    for moment in moments:
        state = moment.state
        for pid, robot in enumerate(state.robots):
            acted = moment.pid in (None, pid)
            slots = {name: values[pid] for name, values in state.store.slots.items()}
            place = next((v for n, v in robot.ports.items() if n.endswith(".position") and isinstance(v, Point)), None)
            if place is not None:
                position = [float(x) for x in (place.x, place.y, place.z)]
                yield {"kind": "pose", "t": float(moment.round), "pid": pid, "position": position, "yaw": 0.0}
            yield {
                "kind": "round",
                "t": float(moment.round),
                "pid": pid,
                "round": moment.round,
                "event": moment.event if acted and moment.event not in ("", "(environment)") else None,
                "skipped": None if acted else "another robot's step",
                "step": moment.event or "the beginning",
                "sensors": _plain({n: v for n, v in robot.ports.items() if n in sensors}),
                "shared": _plain({**slots, **state.store.cells}),
                "actuators": _plain({n: v for n, v in robot.ports.items() if n not in sensors}),
                "locals": _plain(robot.locals),
            }


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    return {name: plain_value(value) for name, value in values.items()}
