"""Counterexamples and runs, as tables of at most 100 columns and as data for JSON."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from typing import Any

from koordgen.lang.semantics.exact import Root
from koordgen.lang.semantics.state import Robot, State
from koordgen.lang.semantics.values import RecordValue
from koordgen.runtime.values.points import Grid, Opaque, Point, Pose
from koordgen.verify.prove.obligations.interface import COMMANDS
from koordgen.verify.prove.report.koord_text import number, to_koord
from koordgen.verify.prove.report.model import Conjunct, Counterexample
from koordgen.verify.prove.report.reach import CounterexampleRun, RunState

WIDTH = 100
CHANGED = "*"


def wrapped(text: str, indent: str = "  ") -> list[str]:
    """Return a sentence, broken into lines that fit the table's width."""
    lines = textwrap.wrap(
        text, WIDTH, initial_indent=indent, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
    return lines or [indent]


def counterexample(found: Counterexample) -> Iterator[str]:
    """Yield the lines of a counterexample: the step, the conjunct that becomes false, the table of values."""
    yield from wrapped(f"{_step(found)}:")
    yield from failed_lines(found.failed, found.discarded, found.file)
    yield ""
    yield from table(found)
    yield ""


def _step(found: Counterexample) -> str:
    place = f"({found.file}:{found.line})" if found.pid is None else ""
    if found.kind == "environment":
        return "a step of the environment, from a state in which all invariants hold"
    if found.kind == "base":
        return f"the state after init {place}".rstrip()
    if found.kind == "interference":
        step = "a command from outside" if found.event == COMMANDS else "a step of another application"
        return f"{step}, from a state in which all invariants hold"
    if found.kind == "guarantee" and found.pid is None:
        return {
            "(first values)": "the first values, before any init",
            "(reflexive)": "a step that changes nothing",
            "(transitive)": "two steps, one after the other, that both keep the guarantee",
        }.get(found.event, f"the state after init {place}".rstrip())
    return f"{found.event} of robot {found.pid}, from a state in which all invariants hold"


def failed_lines(failed: Conjunct | None, discarded: str, file: str) -> list[str]:
    if failed is None:
        return wrapped(f"the event has no result, {discarded}", "    ")
    bound = "".join(f", {name} = {shown(value)}" for name, value in failed.names.items())
    return wrapped(f"false afterwards: {to_koord(failed.formula)}{bound}  ({file}:{failed.formula.span.line})", "    ")


def table(found: Counterexample) -> Iterator[str]:
    """Yield the table of variables before and after a step, with a mark at each change."""
    constants = {"N_SYS": len(found.before.robots), **found.before.params}
    yield from wrapped("  ".join(f"{name} = {shown(value)}" for name, value in constants.items()))
    rows = [("robot", "variable", "before", "after")]
    for owner, name, before, after in cells(found):
        old, new = shown(before), shown(after)
        mark = f" {CHANGED}" if old != new or before != after else ""
        rows.append((owner, name, old, f"{new}{mark}" if mark else ""))
    yield from columns(rows)
    if any("~" in column for row in rows for column in row):
        yield from wrapped("(all numbers are exact; a number after ~ is shown rounded)")


def cells(found: Counterexample) -> Iterator[tuple[str, str, Any, Any]]:
    """Yield the owner, name, value before and value after of each relevant variable.

    The robots' own variables come first, then the shared variables."""
    before, after = found.before, found.after
    for pid, (old, new) in enumerate(zip(before.robots, after.robots, strict=True)):
        for name, value in own(before, pid).items():
            changed = own(after, pid)[name]
            if name in found.seen or value != changed:
                yield str(pid), name, value, changed
            if name in before.store.slots and (started := found.begun.slots[name][pid]) != value:
                yield str(pid), f"{name} (round start)", started, started
        if new.stopped != old.stopped:
            yield str(pid), "stopped", old.stopped, new.stopped
    for name, value in before.store.cells.items():
        if name in found.seen or value != after.store.cells[name]:
            yield "", name, value, after.store.cells[name]
        if (started := found.begun.cells[name]) != value:
            yield "", f"{name} (round start)", started, started


def own(state: State, pid: int) -> dict[str, Any]:
    """Return one robot's variables: its locals, its ports and its slots."""
    robot: Robot = state.robots[pid]
    slots = {name: values[pid] for name, values in state.store.slots.items()}
    return {**robot.ports, **robot.locals, **slots}


def columns(rows: Sequence[tuple[str, ...]]) -> Iterator[str]:
    """Yield columns side by side, within WIDTH. A cell that is too wide continues on further lines."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    room = WIDTH - 2 - 2 * (len(widths) - 1) - widths[0] - widths[1]
    for i in (2, 3):
        widths[i] = min(widths[i], max(room // 2, room - widths[5 - i]))
    last = ""
    for row in rows:
        shown_row = ("" if row[0] == last and row[0] else row[0], *row[1:])
        last = row[0]
        parts = [textwrap.wrap(text, max(8, width)) or [""] for text, width in zip(shown_row, widths, strict=True)]
        for k in range(max(map(len, parts))):
            line = [(part[k] if k < len(part) else "").ljust(width) for part, width in zip(parts, widths, strict=True)]
            yield "  " + "  ".join(line).rstrip()


def run_lines(run: CounterexampleRun, found: Counterexample | None) -> Iterator[str]:
    yield from run_state_lines(run.run_states)
    yield from failed_lines(run.failed, "", found.file if found else "")
    yield from wrapped(agent_order_text(run.of_agents))


def agent_order_text(of_agents: bool) -> str:
    """Return a sentence that states whether robots' agents can execute a run."""
    if of_agents:
        return "robots' agents can execute this run"
    return (
        "robots' agents cannot execute this run: in each round, an agent runs the first event in text order whose "
        "guard holds at the round's start, commits come first, one for each lock, then plain events by ascending pid"
    )


def run_state_lines(run_states: Sequence[RunState]) -> Iterator[str]:
    """Yield a run as lines, one step after another, with the changes of each step."""
    first = run_states[0].state
    constants = {"N_SYS": len(first.robots), **first.params}
    yield from wrapped("  ".join(f"{name} = {shown(value)}" for name, value in constants.items()))
    rows = [("round", "step", "", "")]
    for old, run_state in zip((None, *run_states), run_states, strict=False):
        by = run_state.event or "the beginning"
        step = f"{by} of robot {run_state.pid}" if run_state.pid is not None else by
        changes = list(_changes(old.state if old else None, run_state.state))
        for i, change in enumerate(changes or ["nothing changes"]):
            rows.append((str(run_state.round) if not i else "", step if not i else "", change, ""))
    yield from columns(rows)


def _changes(old: State | None, new: State) -> Iterator[str]:
    for pid in range(len(new.robots)):
        was = own(old, pid) if old else {}
        for name, value in own(new, pid).items():
            if name not in was or was[name] != value:
                yield f"{name}[{pid}] = {shown(value)}"
    for name, value in new.store.cells.items():
        if old is None or old.store.cells[name] != value:
            yield f"{name} = {shown(value)}"


def data(found: Counterexample, run: CounterexampleRun | None) -> dict[str, Any]:
    """Return a counterexample as data for JSON."""
    rows = [
        {"robot": int(owner) if owner else None, "variable": name, "before": shown(before), "after": shown(after)}
        for owner, name, before, after in cells(found)
    ]
    return {
        "kind": found.kind,
        "event": found.event,
        "robot": found.pid,
        "file": found.file,
        "line": found.line,
        "robots": len(found.before.robots),
        "params": _texts(found.before.params),
        "conjunct": to_koord(found.failed.formula) if found.failed else found.discarded,
        "names": _texts(found.failed.names) if found.failed else {},
        "cells": rows,
        "run": run_states_data(run.run_states) if run else None,
        "order_of_agents": run.of_agents if run else None,
    }


def run_states_data(run_states: Sequence[RunState]) -> list[dict[str, Any]]:
    """Return a run as data for JSON."""
    return [_run_state(m.event, m.pid, m.round, m.state) for m in run_states]


def _run_state(event: str, pid: int | None, number: int, state: State) -> dict[str, Any]:
    robots = [_texts(own(state, i)) for i in range(len(state.robots))]
    return {"round": number, "event": event, "robot": pid, "robots": robots, "shared": _texts(state.store.cells)}


def _texts(values: Mapping[str, Any]) -> dict[str, str]:
    return {name: shown(value) for name, value in values.items()}


def shown(value: Any) -> str:
    """Return a value as text in the notation of programs."""
    match value:
        case bool():
            return str(value)
        case int() | Fraction():
            return number(value)
        case Root():
            return f"sqrt({number(value.square)})"
        case float():
            return repr(value)
        case Point(x, y, z):
            return f"({shown(x)}, {shown(y)}, {shown(z)})"
        case Pose(position, yaw):
            return f"Pose({shown(position)}, {shown(yaw)})"
        case Grid(x, y, size):
            return f"Grid({x}, {y}, {shown(size)})"
        case RecordValue(name, fields):
            return f"{name}({', '.join(map(shown, fields))})"
        case Opaque(data):
            return f"#{data.decode(errors='replace')}"
        case tuple():
            return f"[{', '.join(map(shown, value))}]"
        case _:
            return repr(value)
