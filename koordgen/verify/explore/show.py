"""Output of an exploration's result: text, JSON data, and files for other tools."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from typing import Any

from koordgen.lang.ir import decl
from koordgen.lang.semantics.values import RecordValue
from koordgen.runtime.values.points import Point
from koordgen.verify.explore.breadth_first import ExplorationProgress
from koordgen.verify.explore.search import DEADLOCK, LOOP, WELL_DEFINED, ExplorationResult, FoundViolation
from koordgen.verify.prove.report.koord_text import to_koord
from koordgen.verify.prove.report.table import (
    agent_order_text,
    failed_lines,
    own,
    run_state_lines,
    run_states_data,
    wrapped,
)
from koordgen.verify.prove.report.trace import RunOrigin, run_trace

COMMANDS = "commands from outside"  # beginning of the reason `unexplored`


def verdict(violated: bool, stopped: str) -> str:
    """Return the verdict of an exploration: VIOLATED, INCONCLUSIVE or HOLDS.

    `stopped`: the reason why the exploration ended early; empty if everything was explored."""
    if violated:
        return "VIOLATED"
    return "INCONCLUSIVE" if stopped else "HOLDS"


def unexplored(programs: Iterable[decl.Program]) -> str:
    """Return the commands from outside that these programs take, as the reason of an incomplete exploration, or ""."""
    names = sorted({name for program in programs for name in decl.commanded(program)})
    return f"{COMMANDS} to {', '.join(names)}, which are not explored" if names else ""


def stopped_text(stopped: str) -> str:
    """Return why an exploration is not complete. `stopped`: the reason in a result."""
    return f"{'incomplete because of' if stopped.startswith(COMMANDS) else 'ended by'}: {stopped}"


def report(result: ExplorationResult, program: decl.Program, path: str, n_sys: int) -> str:
    """Return the result of an exploration as text for a terminal, at most 100 columns wide."""
    lines = [f"{path}, {n_sys} robot{'s' * (n_sys != 1)}: {verdict(result.violation is not None, result.stopped)}"]
    lines += wrapped(extent(result.progress, result.violation is None and not result.stopped))
    if result.violation is not None:
        lines += ["", *_violation(result.violation, program), ""]
    elif result.stopped:
        lines += wrapped(f"{stopped_text(result.stopped)}; no violation found so far")
    else:
        kept = [p.name for p in program.properties if p.kind == "invariant" and p.name not in result.unchecked]
        lines += wrapped(f"true in every state: {', '.join(kept) or 'the program has no invariants'}")
    if result.unchecked:
        lines += wrapped(f"not checked, since a spec fun cannot be evaluated: {', '.join(result.unchecked)}")
    if result.unseen and result.violation is None:
        never = "never enabled" if not result.stopped else "not enabled so far"
        lines += wrapped(f"{never}: {', '.join(f'{e.name} (line {e.span.line})' for e in result.unseen)}")
    return "\n".join(line.rstrip() for line in lines).rstrip() + "\n"


def progress_text(progress: ExplorationProgress) -> str:
    """Return the progress of an exploration as text: states, steps and seconds."""
    waiting = f"{progress.waiting} of them waiting, " if progress.waiting else ""
    states = f"{progress.states} state{'s' * (progress.states != 1)}"
    return f"{states}, {waiting}{progress.steps} steps, {progress.seconds:.2f} s"


def extent(progress: ExplorationProgress, complete: bool) -> str:
    """Return how much was explored, as text."""
    return f"explored {'completely, ' * complete}to depth {progress.depth}; {progress_text(progress)}"


def headline(name: str, of: str, rounds: int, shortest: int | None) -> str:
    """Return the sentence that introduces the run to a violation.

    `name`: the violated property. `of`: " of" and its application, or empty. `rounds`: number of rounds of the run.
    `shortest`: number of rounds of the shortest run that the language allows; None if the run is this short."""
    after = f"after {rounds} round{'s' * (rounds != 1)}" if rounds else "at the beginning"
    what = {DEADLOCK: "deadlock", WELL_DEFINED: f"an event{of} without a result"}.get(name)
    if name.startswith(LOOP):
        what = f"the loop invariant on {name}{of} is violated"
    fewer = "no run with fewer rounds leads to a violation"
    if shortest is not None:
        fewer = f"the language allows it after {shortest}, in an order of events that agents never use"
    return f"{what or f'{name}{of} is violated'} {after}; {fewer}:"


def _violation(found: FoundViolation, program: decl.Program) -> Iterator[str]:
    yield from wrapped(headline(found.name, "", found.run_states[-1].round, found.shortest))
    yield from run_state_lines(found.run_states)
    if found.failed is not None:
        yield from failed_lines(found.failed, "", program.path)
    else:
        place = f"  ({program.path}:{found.line})" if found.line else ""
        yield from wrapped(f"  {found.reason}{place}")
    yield from wrapped(agent_order_text(found.of_agents))


def document(result: ExplorationResult, program: decl.Program, n_sys: int) -> dict[str, Any]:
    """Return the result of an exploration as data for JSON."""
    found = result.violation
    return {
        "verdict": verdict(found is not None, result.stopped),
        "robots": n_sys,
        "complete": found is None and not result.stopped,
        "stopped": result.stopped or None,
        **result.progress._asdict(),
        "invariants": [p.name for p in program.properties if p.kind == "invariant"],
        "unchecked": list(result.unchecked),
        "never_enabled": [{"event": e.name, "line": e.span.line} for e in result.unseen],
        "robots_alike": not result.apart,
        "told_apart_by": result.apart or None,
        "forgotten": list(result.forgotten),
        "violation": _data(found) if found is not None else None,
    }


def _data(found: FoundViolation) -> dict[str, Any]:
    return {
        "what": found.name,
        "line": found.failed.formula.span.line if found.failed else found.line,
        "conjunct": to_koord(found.failed.formula) if found.failed else found.reason,
        "rounds": found.run_states[-1].round,
        "shortest": found.run_states[-1].round if found.shortest is None else found.shortest,
        "order_of_agents": found.of_agents,
        "run": run_states_data(found.run_states),
    }


def trace(found: FoundViolation, program: decl.Program, about: RunOrigin) -> str:
    """Return the run to a violation as the text of a trace file."""
    line = found.failed.formula.span.line if found.failed else found.line
    detail = f"false: {to_koord(found.failed.formula)}" if found.failed else found.reason
    culprit = None
    if found.culprit is not None and found.culprit.pid is not None:
        culprit = found.culprit.pid, found.culprit.event
    return run_trace(program, found.run_states, (found.name, line, detail), about, culprit)


def itf(found: FoundViolation, program: decl.Program) -> str:
    """Return the run to a violation in Apalache's Informal Trace Format (ADR-015).

    Viewers of TLA+ traces read this format."""
    robots = range(len(found.run_states[0].state.robots))
    cells = [v.name for v in program.shared if v.kind == "allwrite"]
    names = [*own(found.run_states[0].state, 0), "stopped"]
    states = []
    for index, run_state in enumerate(found.run_states):
        held = [{**own(run_state.state, pid), "stopped": run_state.state.robots[pid].stopped} for pid in robots]
        state: dict[str, Any] = {"#meta": {"index": index}, "step": run_state.event or "the beginning"}
        pid = -1 if run_state.pid is None else run_state.pid
        state |= {"robot": itf_value(pid), "round": itf_value(run_state.round)}
        state |= {name: {"#map": [[itf_value(pid), itf_value(held[pid][name])] for pid in robots]} for name in names}
        states.append(state | {name: itf_value(run_state.state.store.cells[name]) for name in cells})
    meta = {"format": "ITF", "source": program.path, "description": f"{found.name} is violated"}
    document = {"#meta": meta, "vars": ["step", "robot", "round", *names, *cells], "states": states}
    return json.dumps(document, indent=1) + "\n"


def itf_value(value: Any) -> Any:
    """Return a value as the Informal Trace Format writes it."""
    match value:
        case bool() | str():
            return value
        case int():
            return {"#bigint": str(value)}
        case Point(x, y, z):
            return {"#tup": [itf_value(x), itf_value(y), itf_value(z)]}
        case RecordValue(name, fields):
            return {"#tup": [name, *map(itf_value, fields)]}
        case tuple():
            return [*map(itf_value, value)]
        case _:
            return str(value)  # the format has no real numbers, so floats become strings
