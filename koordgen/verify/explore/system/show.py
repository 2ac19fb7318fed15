"""Output of an exploration of a system: text, JSON data, and a file for viewers of TLA+ traces.

Each event names its application and its robot. A local variable or a slot is shown as `application.variable[pid]`, with
the pid in that application; a port as `Module.port of robot`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from koordgen.lang.semantics.composition import System
from koordgen.lang.semantics.system import SystemState
from koordgen.lang.semantics.values import Value
from koordgen.verify.explore.show import extent, headline, itf_value, stopped_text, verdict
from koordgen.verify.explore.system.search import SystemResult, SystemRunState, SystemViolation
from koordgen.verify.prove.report.koord_text import to_koord
from koordgen.verify.prove.report.table import columns, failed_lines, shown, wrapped

APART = "the fleet runs several applications"
OF_AGENTS = "robots' agents can execute this run"
NOT_OF_AGENTS = (
    "no run to this violation is known that robots' agents can execute: in each round, an agent runs for each of its"
    " applications the first event in text order whose guard holds at the round's start, commits come first, one for"
    " each lock, then plain events by application and pid"
)


def report(result: SystemResult, system: System, path: str, robots: Sequence[str]) -> str:
    """Return the result of an exploration as text for a terminal, at most 100 columns wide.

    `robots`: the names of the robots, by their places in the fleet file."""
    found = result.violation
    count = f"{len(system.applications)} applications, {system.robots} robot{'s' * (system.robots != 1)}"
    lines = [f"{path}, {count}: {verdict(found is not None, result.stopped)}"]
    lines += wrapped(extent(result.progress, found is None and not result.stopped))
    lines += wrapped(f"no two robots count as alike, because {APART}")
    if found is not None:
        lines += ["", *_violation(found, system, robots), ""]
    elif result.stopped:
        lines += wrapped(f"{stopped_text(result.stopped)}; no violation found so far")
    else:
        left = {(system.applications[a].name, name) for a, name in result.unchecked}
        kept = [f"{name} of {a}" for a, name in properties(system) if (a, name) not in left]
        lines += wrapped(f"true in every state and step: {', '.join(kept) or 'the programs have no properties'}")
    if result.unchecked:
        unchecked = ", ".join([f"{name} of {system.applications[a].name}" for a, name in result.unchecked])
        lines += wrapped(f"not checked, since a spec fun cannot be evaluated: {unchecked}")
    if result.unseen and found is None:
        never = "never enabled" if not result.stopped else "not enabled so far"
        events = [f"{e.name} of {system.applications[a].name} (line {e.span.line})" for a, e in result.unseen]
        lines += wrapped(f"{never}: {', '.join(events)}")
    return "\n".join(line.rstrip() for line in lines).rstrip() + "\n"


def properties(system: System) -> list[tuple[str, str]]:
    """Return the names of all invariants and guarantees, with their applications."""
    found = []
    for application in system.applications:
        names = [p.name for p in application.program.properties if p.kind == "invariant"]
        names += [g.name for export in application.program.exports for g in export.guarantees]
        found += [(application.name, name) for name in names]
    return found


def _violation(found: SystemViolation, system: System, robots: Sequence[str]) -> Iterator[str]:
    program = None if found.application is None else system.applications[found.application].program
    of = "" if found.application is None else f" of {system.applications[found.application].name}"
    yield from wrapped(headline(found.name, of, found.run_states[-1].round, found.shortest))
    yield from _constants(found.run_states[0].state, system, robots)
    yield from _run(found.run_states, system, robots)
    if found.failed is not None and program is not None:
        yield from failed_lines(found.failed, "", program.path)
    else:
        place = f"  ({program.path}:{found.line})" if program is not None and found.line else ""
        yield from wrapped(f"  {found.reason}{place}")
    yield from wrapped(OF_AGENTS if found.of_agents else NOT_OF_AGENTS)


def _constants(state: SystemState, system: System, robots: Sequence[str]) -> Iterator[str]:
    """Yield a line for each application: its robots by their pids, and its params."""
    for application, params in zip(system.applications, state.params, strict=True):
        names = ", ".join([robots[robot] for robot in application.members])
        given = "".join([f"; {name} = {shown(value)}" for name, value in params.items()])
        yield from wrapped(f"{application.name} on {names}{given}")


def _run(run_states: Sequence[SystemRunState], system: System, robots: Sequence[str]) -> Iterator[str]:
    """Yield a run as lines, one step after another, with the changes of each step."""
    rows, old = [("round", "step", "", "")], dict[str, Value]()
    for run_state in run_states:
        new = variables(run_state.state, system, robots)
        changes = [f"{name} = {shown(value)}" for name, value in new.items() if name not in old or old[name] != value]
        for index, change in enumerate(changes or ["nothing changes"]):
            step = (str(run_state.round), _step(run_state, system, robots)) if not index else ("", "")
            rows.append((*step, change, ""))
        old = new
    yield from columns(rows)


def _step(run_state: SystemRunState, system: System, robots: Sequence[str]) -> str:
    if run_state.instance is None:
        return run_state.event or "the beginning"
    instance = system.instances()[run_state.instance]
    return f"{run_state.event} of {system.applications[instance.application].name} on {robots[instance.robot]}"


def variables(state: SystemState, system: System, robots: Sequence[str]) -> dict[str, Value]:
    """Return the values of all variables and ports of a state, under the names of the output."""
    on = zip(robots, state.ports, strict=True)
    found = {f"{name} of {robot}": value for robot, ports in on for name, value in ports.items()}
    for index, application in enumerate(system.applications):
        for pid, names in enumerate(own(state, index)):
            found |= {f"{application.name}.{name}[{pid}]": value for name, value in names.items()}
        found |= {f"{application.name}.{name}": value for name, value in state.stores[index].cells.items()}
    return found


def own(state: SystemState, application: int) -> list[dict[str, Value]]:
    """Return the local variables and slots of each instance of an application, by pid."""
    slots = state.stores[application].slots
    return [
        {**names, **{name: values[pid] for name, values in slots.items()}}
        for pid, names in enumerate(state.locals[application])
    ]


def document(result: SystemResult, system: System, robots: Sequence[str]) -> dict[str, Any]:
    """Return the result of an exploration as data for JSON. `robots`: the names of the robots."""
    found, names = result.violation, [application.name for application in system.applications]
    return {
        "verdict": verdict(found is not None, result.stopped),
        "robots": system.robots,
        "applications": [
            {"application": a.name, "source": a.program.path, "robots": [robots[robot] for robot in a.members]}
            for a in system.applications
        ],
        "complete": found is None and not result.stopped,
        "stopped": result.stopped or None,
        **result.progress._asdict(),
        "properties": [{"application": name, "property": property_} for name, property_ in properties(system)],
        "unchecked": [{"application": names[a], "property": name} for a, name in result.unchecked],
        "never_enabled": [{"application": names[a], "event": e.name, "line": e.span.line} for a, e in result.unseen],
        "robots_alike": False,
        "told_apart_by": APART,
        "violation": _data(found, system, robots) if found is not None else None,
    }


def _data(found: SystemViolation, system: System, robots: Sequence[str]) -> dict[str, Any]:
    rounds = found.run_states[-1].round
    return {
        "application": None if found.application is None else system.applications[found.application].name,
        "what": found.name,
        "line": found.failed.formula.span.line if found.failed else found.line,
        "conjunct": to_koord(found.failed.formula) if found.failed else found.reason,
        "rounds": rounds,
        "shortest": rounds if found.shortest is None else found.shortest,
        "order_of_agents": found.of_agents,
        "run": [_run_state(run_state, system, robots) for run_state in found.run_states],
    }


def _run_state(run_state: SystemRunState, system: System, robots: Sequence[str]) -> dict[str, Any]:
    instance = None if run_state.instance is None else system.instances()[run_state.instance]
    state = run_state.state
    return {
        "round": run_state.round,
        "event": run_state.event,
        "application": None if instance is None else system.applications[instance.application].name,
        "robot": None if instance is None else robots[instance.robot],
        "pid": None if instance is None else instance.pid,
        "applications": {
            application.name: {"robots": list(map(_texts, own(state, a))), "shared": _texts(state.stores[a].cells)}
            for a, application in enumerate(system.applications)
        },
        "ports": {robot: _texts(ports) for robot, ports in zip(robots, state.ports, strict=True)},
    }


def _texts(values: Mapping[str, Value]) -> dict[str, str]:
    return {name: shown(value) for name, value in values.items()}


def itf(found: SystemViolation, system: System, robots: Sequence[str]) -> str:
    """Return the run to a violation in Apalache's Informal Trace Format (ADR-015)."""
    states, names = [], list(variables(found.run_states[0].state, system, robots))
    for index, run_state in enumerate(found.run_states):
        instance = None if run_state.instance is None else system.instances()[run_state.instance]
        by = ("", "") if instance is None else (system.applications[instance.application].name, robots[instance.robot])
        state: dict[str, Any] = {"#meta": {"index": index}, "step": run_state.event or "the beginning"}
        state |= {"application": by[0], "robot": by[1], "round": itf_value(run_state.round)}
        state["stopped"] = [list(each) for each in run_state.state.stopped]
        states.append(state | {n: itf_value(v) for n, v in variables(run_state.state, system, robots).items()})
    sources = ", ".join([application.program.path for application in system.applications])
    meta = {"format": "ITF", "source": sources, "description": f"{found.name} is violated"}
    document = {"#meta": meta, "vars": ["step", "application", "robot", "round", "stopped", *names], "states": states}
    return json.dumps(document, indent=1) + "\n"
