"""A counterexample as a trace, format koord-trace/1 (see docs/sim.md): what simulators and replayers read."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from koordgen.ir import decl
from koordgen.prove.explain import Explanation
from koordgen.prove.model import Conjunct, Counterexample, plain_value
from koordgen.prove.reach import Moment
from koordgen.semantics.state import State

FORMAT = "koord-trace/1"


def trace(program: decl.Program, told: Explanation) -> str:
    """JSON lines: a header, then each step as a round of each robot; a last one tells what is violated. One second
    stands for each round. Numbers that are no float are fractions, as text."""
    found = told.counterexample
    if found is None:
        return ""
    failed: Conjunct | None
    if told.run is not None:
        moments, failed = told.run.moments, told.run.failed
    else:
        moments, failed = _pair(found), found.failed
    where = (
        {"line": failed.formula.span.line, "file": program.path} if failed is not None else {"detail": found.discarded}
    )
    return run_trace(program, moments, {"what": found.invariant, **where})


def run_trace(program: decl.Program, moments: tuple[Moment, ...], violation: Mapping[str, Any]) -> str:
    """A run whose last moment is a violation."""
    lines = [_header(program, moments[0].state), *_steps(program, moments)]
    lines.append({"kind": "violation", "t": float(moments[-1].round), **violation})
    return "".join(json.dumps(line) + "\n" for line in lines)


def _pair(found: Counterexample) -> tuple[Moment, ...]:
    return Moment(found.before, "", None, 1), Moment(found.after, found.event, found.pid, 1)


def _header(program: decl.Program, state: State) -> dict[str, Any]:
    return {
        "kind": "header",
        "format": FORMAT,
        "app": program.name,
        "delta": 1.0,
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
