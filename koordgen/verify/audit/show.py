"""Output of an audit's result: text of at most 100 columns, and data for JSON."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from koordgen.verify.audit.blame import Blame
from koordgen.verify.audit.history import FleetMission
from koordgen.verify.audit.result import BEGIN, AuditViolation, PropertyResult
from koordgen.verify.prove.report.show import wrapped

WIDTH = 100
MOST_MISSING = 3
MOST_NOTES = 12
PROVED = "PROVED"


@dataclass(frozen=True, slots=True)
class Audit:
    """Finished audit of a mission, or of one of several applications in it.

    `proved`: name of an invariant -> verdict of `koordgen prove`; None if the prover did not run.
    `ended`: whether a time limit ended the audit before the last round."""

    program: str  # path of the program's file
    mission: FleetMission
    results: Sequence[PropertyResult]
    blames: Sequence[Blame]
    notes: Sequence[str]
    proved: Mapping[str, str] | None = None
    ended: bool = False
    application: str = ""  # name of the application; "": the fleet has one program

    @property
    def violated(self) -> bool:
        return any(f.first is not None for f in self.results)

    @property
    def doubtful(self) -> bool:
        """Return whether the audit is incomplete: unknown values, missing parts of traces, or a time limit."""
        return (
            self.ended
            or self.mission.cut
            or any(f.verdict in ("unknown", "unchecked") for f in self.results if f.of != "axiom")
        )


def report(audit: Audit) -> str:
    mission = audit.mission
    robots = sum(bool(history.lives) for history in mission.histories)
    rounds = f"{mission.last} round{'s' * (mission.last != 1)}"
    if mission.first:
        rounds += f", unknown before round {mission.first}"
    name = f"{audit.application}: " if audit.application else ""
    lines = [f"{name}{audit.program}, {robots} of {len(mission.histories)} robots, {rounds}", ""]
    lines += _table(audit.results)
    for result in audit.results:
        lines += _details(result, audit)
    if audit.notes:
        lines += ["", *note_lines(audit.notes)]
    return "\n".join(line.rstrip() for line in lines).rstrip() + "\n"


def note_lines(notes: Sequence[str]) -> Iterator[str]:
    yield "notes:"
    more = [f"and {len(notes) - MOST_NOTES} more"] * (len(notes) > MOST_NOTES)
    for note in (*notes[:MOST_NOTES], *more):
        yield from textwrap.wrap(note, WIDTH, initial_indent="  - ", subsequent_indent="    ", break_on_hyphens=False)


def _table(results: Sequence[PropertyResult]) -> Iterator[str]:
    rows = [("verdict", "property", "line", "rounds", "violated", "unknown")]
    rows += [
        (f.verdict, f.title, str(f.line or ""), str(f.rounds), str(f.violated or ""), str(f.unknown or ""))
        for f in results
    ]
    widths = [min(46, max(len(row[k]) for row in rows)) for k in range(len(rows[0]))]
    for row in rows:
        cells = [
            text if len(text) <= width else f"{text[: width - 3]}..." for text, width in zip(row, widths, strict=True)
        ]
        left = [cell.ljust(width) for cell, width in zip(cells[:2], widths[:2], strict=True)]
        right = [cell.rjust(width) for cell, width in zip(cells[2:], widths[2:], strict=True)]
        yield "  ".join([*left, *right])


def _details(result: PropertyResult, audit: Audit) -> Iterator[str]:
    if result.first is not None:
        yield ""
        yield from _violation(result, result.first, audit)
        for blame in audit.blames:
            if blame.invariant is result:
                yield from [""] if result.first.rows else []
                yield from wrapped(sentence(blame, audit))
    if result.unchecked and result.verdict == "unchecked":
        yield from ("", *wrapped(f"{result.title}: {result.unchecked}"))
    if result.unknown:
        yield from ("", f"{result.title}, unknown in {result.unknown} round{'s' * (result.unknown != 1)}:")
        missing = sorted(result.missing.items(), key=lambda each: -each[1])
        for text, count in missing[:MOST_MISSING]:
            yield from wrapped(f"{text} ({count})")
        if len(missing) > MOST_MISSING:
            yield f"  and {len(missing) - MOST_MISSING} more reasons"


def when(violation: AuditViolation, mission: FleetMission) -> str:
    """Return the time of a violation as text: seconds since round 1 began, round, fleet time."""
    seconds = violation.observation.seconds(mission.delta)
    round_ = violation.observation.round
    if round_ == 0:
        return (
            "as round 1 begins"
            if violation.observation.end
            else violation.where
            if violation.where == BEGIN
            else "after init"
        )
    fleet = f", {mission.start + seconds:.2f} s of fleet time" if mission.start is not None else ""
    return f"{seconds:.2f} s, round {round_} {violation.where}{fleet}"


def _violation(result: PropertyResult, first: AuditViolation, audit: Audit) -> Iterator[str]:
    verb = "has no value" if result.verdict == "no value" else "is violated"
    place = f" ({audit.program}:{result.line})" if result.line else ""
    robots = f", {', '.join(first.robots)}" if first.robots else ""
    yield f"{result.title} {verb}{place}"
    yield from wrapped(f"{when(first, audit.mission)}{robots}")
    reason = "; ".join(filter(None, (", ".join(first.bound), "; ".join(first.read), first.why)))
    if reason:
        yield from wrapped(reason)
    if first.rows:
        yield ""
        yield from _rows(first)


def _rows(violation: AuditViolation) -> Iterator[str]:
    rows = [("robot", "variable", "before", "after")]
    last = ""
    for robot, variable, before, after in violation.rows:
        rows.append(("" if robot == last else robot, variable, before, f"{after} *" if before != after else ""))
        last = robot
    widths = [min(34, max(len(row[k]) for row in rows)) for k in range(4)]
    for row in rows:
        parts = [textwrap.wrap(text, width) or [""] for text, width in zip(row, widths, strict=True)]
        for k in range(max(map(len, parts))):
            cells = [(part[k] if k < len(part) else "").ljust(width) for part, width in zip(parts, widths, strict=True)]
            yield "  " + "  ".join(cells).rstrip()


def sentence(blame: Blame, audit: Audit) -> str:
    """Return a sentence about what the violation of an invariant means for the proof of the invariant."""
    name = blame.invariant.name
    said = None if audit.proved is None else audit.proved.get(name, "nothing")
    uncovered = _uncovered(blame, audit.mission)
    if blame.guarantees:
        uncovered += f"; the proof also rests on {', '.join(blame.guarantees)}, which other applications must keep"
    if blame.broke:
        told = [_broke(result, audit.mission) for _, result in blame.broke]
        verb = "rests" if said == PROVED else "would rest"
        return f"the proof of {name} {verb} on {'; and on '.join(told)}{uncovered}"
    seen = f"no assumption of its proof broke before it{uncovered}"
    if blame.unseen:
        texts = ", ".join(f"{e.kind} in line {e.line}" for e in blame.unseen)
        seen = f"no assumption of its proof was seen to break before it, but some were not observed: {texts}{uncovered}"
    bug = (
        "koordgen has a bug, or robots did something that its model does not contain (`koordgen replay` compares "
        "what robots did with the program): please report the violation, with these traces"
    )
    if said is None:
        return f"{seen}. If `koordgen prove` says PROVED of {name} (the option `--prove` runs it), {bug}"
    if said != PROVED:
        return f"`koordgen prove` says {said} of {name} with these params, so no proof covers it"
    return f"{name} is PROVED, and {seen}: {bug}"


def _uncovered(blame: Blame, mission: FleetMission) -> str:
    """Return a clause that names robots whose behaviour no proof covers; empty without such robots.

    Such a robot had stopped, had been removed from the fleet, or had a gap in its trace before the violation."""
    first = blame.invariant.first
    assert first is not None
    names = [
        history.name
        for history in mission.histories
        if any(gap.since <= first.observation.round for gap in (*history.out, *history.away, *history.quiet))
    ]
    return f"; by then {', '.join(names)} had been outside of the model, which no proof covers" if names else ""


def _broke(result: PropertyResult, mission: FleetMission) -> str:
    first = result.first
    assert first is not None
    robots = f" by robot {', '.join(first.robots)}" if first.robots else ""
    return f"`{result.title}` (line {result.line}), which broke at {when(first, mission)}{robots}"


def fleet_document(audits: Sequence[Audit], notes: Sequence[str], status: int) -> dict[str, Any]:
    """Return the result of a fleet with several applications. `notes`: those about the traces of all applications."""
    parts = [{"application": audit.application, **document(audit, status)} for audit in audits]
    return {"status": status, "notes": list(notes), "applications": parts}


def document(audit: Audit, status: int) -> dict[str, Any]:
    mission = audit.mission
    return {
        "program": audit.program,
        "mission": mission.name or None,
        "delta": mission.delta,
        "first": mission.first,
        "rounds": mission.last,
        "status": status,
        "robots": [
            {
                "name": history.name,
                "pid": history.pid,
                "files": list(dict.fromkeys(str(life.log.path) for life in history.lives)),
                "lives": len(history.lives[:1]) + sum(not life.continues for life in history.lives[1:]),
                "last": history.last,
            }
            for history in mission.histories
        ],
        "properties": [_property(result, audit) for result in audit.results],
        "notes": list(audit.notes),
    }


def _property(result: PropertyResult, audit: Audit) -> dict[str, Any]:
    blame = next((b for b in audit.blames if b.invariant is result), None)
    return {
        "of": result.of,
        "name": result.name,
        "line": result.line,
        "verdict": result.verdict,
        "rounds": result.rounds,
        "violated": result.violated,
        "unknown": result.unknown,
        "unchecked": result.unchecked or None,
        "missing": result.missing,
        "spans": [span._asdict() for span in result.spans],
        "first": _first(result.first, audit.mission) if result.first is not None else None,
        "proof": _proof(blame, audit) if blame is not None else None,
    }


def _first(first: AuditViolation, mission: FleetMission) -> dict[str, Any]:
    seconds = first.observation.seconds(mission.delta)
    return {
        "round": first.observation.round,
        "at_end": first.observation.end,
        "seconds": seconds,
        "fleet_time": None if mission.start is None else mission.start + seconds,
        "robots": list(first.robots),
        "bound": list(first.bound),
        "read": list(first.read),
        "why": first.why or None,
        "rows": [row._asdict() for row in first.rows],
    }


def _proof(blame: Blame, audit: Audit) -> dict[str, Any]:
    return {
        "verdict": None if audit.proved is None else audit.proved.get(blame.invariant.name),
        "says": sentence(blame, audit),
        "broke": [
            {
                "of": f.of,
                "name": f.name,
                "line": f.line,
                "round": f.first.observation.round,
                "robots": list(f.first.robots),
            }
            for _, f in blame.broke
            if f.first is not None
        ],
        "unseen": [entry.line for entry in blame.unseen],
        "rests_on": [entry._asdict() for entry in blame.rests],
    }
