"""Verdicts as people read them, at most 100 columns wide, and as data."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from koordgen.prove.model import Conjunct, Counterexample
from koordgen.prove.reach import Run
from koordgen.prove.spell import shown, spelled
from koordgen.prove.verdict import Verdict
from koordgen.semantics.state import Robot, State

WIDTH = 100
CHANGED = "*"


def report(verdicts: Sequence[Verdict], path: str) -> str:
    """All verdicts, then what they take for granted."""
    robots = verdicts[0].robots if verdicts else None
    fleet = "every number of robots" if robots is None else f"{robots} robot{'s' * (robots != 1)}"
    lines = [f"{path}, for {fleet}", ""]
    for verdict in verdicts:
        lines += [*_verdict(verdict), ""]
    lines += _ledger(verdicts)
    return "\n".join(line.rstrip() for line in lines).rstrip() + "\n"


def _verdict(verdict: Verdict) -> Iterator[str]:
    count = len(verdict.outcomes)
    seconds = sum(o.answer.seconds for o in verdict.outcomes)
    measured = f"{count} obligation{'s' * (count != 1)}, {1000 * seconds:.0f} ms"
    yield f"{verdict.verdict:<14} {verdict.invariant}  ({measured})"
    if verdict.rests_on:
        yield from _wrapped(f"rests on {', '.join(verdict.rests_on)}")
    if verdict.reason:
        yield from _wrapped(verdict.reason)
    told = verdict.explanation
    if told is None:
        return
    if told.unshown and not verdict.reason:
        yield from _wrapped(told.unshown)
    if told.run is not None:
        yield from _wrapped("a run from an initial state, made by the executable semantics, ends where it is false:")
        yield from _run(told.run, told.counterexample)
    elif told.counterexample is not None:
        yield from counterexample(told.counterexample)
    if told.counterexample is not None and told.run is None:
        yield from _wrapped(
            suggestion(verdict) or "nothing that was tried closes the proof; think of what else is true"
        )


def suggestion(verdict: Verdict) -> str:
    """What closes the proof, in a sentence; empty where that is not known."""
    told = verdict.explanation
    if told is None or not told.lacking:
        return ""
    added = " and ".join(f"`{conjunct}`" for conjunct in told.lacking)
    return f"add {added} to {verdict.invariant}: then it is PROVED"


def _wrapped(text: str, indent: str = "  ") -> list[str]:
    lines = textwrap.wrap(
        text, WIDTH, initial_indent=indent, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
    return lines or [indent]


def counterexample(found: Counterexample) -> Iterator[str]:
    """The step, what it makes false, and the table of what was before and after it."""
    yield from _wrapped(f"{_step(found)}:")
    yield from _failed(found.failed, found.discarded, found.file)
    yield ""
    yield from table(found)
    yield ""


def _step(found: Counterexample) -> str:
    place = f"({found.file}:{found.line})" if found.pid is None else ""
    if found.kind == "environment":
        return "a step of the environment, from a state in which all invariants hold"
    if found.kind == "base":
        return f"the state after init {place}".rstrip()
    return f"{found.event} of robot {found.pid}, from a state in which all invariants hold"


def _failed(failed: Conjunct | None, discarded: str, file: str) -> list[str]:
    if failed is None:
        return _wrapped(f"it has no result, {discarded}", "    ")
    bound = "".join(f", {name} = {shown(value)}" for name, value in failed.names.items())
    return _wrapped(f"false then: {spelled(failed.formula)}{bound}  ({file}:{failed.formula.span.line})", "    ")


def table(found: Counterexample) -> Iterator[str]:
    """Robot by variable, before and after; what changed is marked."""
    constants = {"N_SYS": len(found.before.robots), **found.before.params}
    yield from _wrapped("  ".join(f"{name} = {shown(value)}" for name, value in constants.items()))
    rows = [("robot", "variable", "before", "after")]
    for owner, name, before, after in cells(found):
        old, new = shown(before), shown(after)
        mark = f" {CHANGED}" if old != new or before != after else ""
        rows.append((owner, name, old, f"{new}{mark}" if mark else ""))
    yield from _columns(rows)
    if any("~" in column for row in rows for column in row):
        yield from _wrapped("(all is reckoned exactly; numbers behind ~ are shown rounded)")


def cells(found: Counterexample) -> Iterator[tuple[str, str, Any, Any]]:
    """Whose, which variable, before, after: of all that matters; a robot's own, then what is shared."""
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
    """What belongs to a robot: its locals, its ports, its slots."""
    robot: Robot = state.robots[pid]
    slots = {name: values[pid] for name, values in state.store.slots.items()}
    return {**robot.ports, **robot.locals, **slots}


def _columns(rows: Sequence[tuple[str, ...]]) -> Iterator[str]:
    """Columns side by side, within WIDTH: what is too wide goes on below."""
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


def _run(run: Run, found: Counterexample | None) -> Iterator[str]:
    first = run.moments[0].state
    constants = {"N_SYS": len(first.robots), **first.params}
    yield from _wrapped("  ".join(f"{name} = {shown(value)}" for name, value in constants.items()))
    rows = [("round", "step", "", "")]
    for old, moment in zip((None, *run.moments), run.moments, strict=False):
        by = moment.event or "the beginning"
        step = f"{by} of robot {moment.pid}" if moment.pid is not None else by
        changes = list(_changes(old.state if old else None, moment.state))
        for i, change in enumerate(changes or ["nothing changes"]):
            rows.append((str(moment.round) if not i else "", step if not i else "", change, ""))
    yield from _columns(rows)
    yield from _failed(run.failed, "", found.file if found else "")


def _changes(old: State | None, new: State) -> Iterator[str]:
    for pid in range(len(new.robots)):
        was = own(old, pid) if old else {}
        for name, value in own(new, pid).items():
            if name not in was or was[name] != value:
                yield f"{name}[{pid}] = {shown(value)}"
    for name, value in new.store.cells.items():
        if old is None or old.store.cells[name] != value:
            yield f"{name} = {shown(value)}"


def _ledger(verdicts: Iterable[Verdict]) -> Iterator[str]:
    entries = dict.fromkeys(entry for verdict in verdicts for entry in verdict.assumptions)
    if not entries:
        return
    yield "assumed:"
    for entry in entries:
        place = f" ({entry.file}:{entry.line})" if entry.line else ""
        checked = f"checked: {entry.checked}" if entry.checked else "unchecked"
        yield from textwrap.wrap(
            f"{entry.kind}: {entry.text}{place}; {checked}", WIDTH, initial_indent="  - ", subsequent_indent="    "
        )


def document(verdicts: Sequence[Verdict]) -> dict[str, Any]:
    """All verdicts as JSON has them."""
    return {"invariants": [_json(verdict) for verdict in verdicts]}


def _json(verdict: Verdict) -> dict[str, Any]:
    told = verdict.explanation
    obligations = [
        {
            "name": o.obligation.name,
            "file": o.obligation.file,
            "line": o.obligation.line,
            "result": o.answer.result,
            "seconds": round(o.answer.seconds, 6),
        }
        for o in verdict.outcomes
    ]
    rests = [
        {"kind": "invariant", "text": name, "file": "", "line": 0, "checked": "PROVED here"}
        for name in verdict.rests_on
    ]
    return {
        "name": verdict.invariant,
        "verdict": verdict.verdict,
        "robots": "any" if verdict.robots is None else verdict.robots,
        "obligations": obligations,
        "counterexample": _found(told.counterexample, told.run) if told and told.counterexample else None,
        "suggestion": suggestion(verdict) or verdict.reason or None,
        "assumptions": [*rests, *(entry._asdict() for entry in verdict.assumptions)],
    }


def _found(found: Counterexample, run: Run | None) -> dict[str, Any]:
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
        "conjunct": spelled(found.failed.formula) if found.failed else found.discarded,
        "names": _texts(found.failed.names) if found.failed else {},
        "cells": rows,
        "run": [_moment(m.event, m.pid, m.round, m.state) for m in run.moments] if run else None,
    }


def _moment(event: str, pid: int | None, number: int, state: State) -> dict[str, Any]:
    robots = [_texts(own(state, i)) for i in range(len(state.robots))]
    return {"round": number, "event": event, "robot": pid, "robots": robots, "shared": _texts(state.store.cells)}


def _texts(values: Mapping[str, Any]) -> dict[str, str]:
    return {name: shown(value) for name, value in values.items()}
