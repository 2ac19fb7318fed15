"""Report of a run: one self-contained HTML file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path

import msgspec

from koordgen.runtime.trace.schema import Header, LogLine, Monitor, Phase, Round, TraceRecord, Verdict, Violation
from targets.sim.judging.summary import (
    LEFT_OPEN,
    RobotSummary,
    Summary,
    found_text,
    headline,
    place,
    seconds,
    squads_of,
    stalled,
    summarise,
    violation_text,
    waits,
    warned,
)
from targets.sim.run.run import RunResult
from targets.sim.run.scene import Closest
from targets.sim.trace.files import read
from targets.sim.trace.monitor_reports import DisplayFilter, status_text
from targets.sim.view.data.history import gathered
from targets.sim.view.data.rows import Chunk
from targets.sim.view.web.page import page

MOST_LINES = 200  # events and log lines shown
MOST_VIOLATIONS, MOST_WARNINGS = 20, 100  # shown above the pictures
FEW = 5  # longest list that is shown unfolded
GREEN, RED, AMBER = "#1B7F4B", "#B00020", "#8A5A00"
COLOURS = {"held": GREEN, "violated": RED, "host overloaded": AMBER, "interrupted": AMBER, "not started": RED}
CLASSES = {"held": "good", "violated": "bad", "no value": "bad", "unchecked": "warn", "out of model": "warn"}
BAD = {"error", "fault", "separation", "collision", "ended", "not_stopped", "property", "idle"}


def important(header: Header, records: Iterable[TraceRecord]) -> list[tuple[float, str, str, str]]:
    """Return the trace's main records as (t, robot, kind, text).

    All violations, and the first MOST_LINES of changed phases, warnings, errors, violations reported by monitors, and
    each robot's distinct faults."""
    names = {robot.pid: robot.name for robot in header.robots}
    seen: set[tuple[int, str]] = set()
    phases: dict[int, str] = {}
    notable = DisplayFilter()
    found: list[tuple[float, str, str, str]] = []
    violations = 0
    for record in records:
        match record:
            case Violation():
                violations += 1
                found.append((record.t, " and ".join(record.robots), record.what, record.detail))
                continue
            case _ if len(found) - violations >= MOST_LINES:
                continue
            case Phase() if phases.get(record.pid) != record.phase:
                phases[record.pid] = record.phase
                found.append((record.t, names.get(record.pid, "?"), record.phase, record.detail))
            case Monitor() if notable.add(record):
                text = f"{status_text(record)} ({record.line})" + (f": {record.why}" if record.why else "")
                found.append((record.t, names.get(record.pid, "?"), "monitor", text))
            case LogLine() if record.level != "info":
                found.append((record.t, names.get(record.pid, "?"), record.level, record.message))
            case Round(fault=fault) if fault is not None and (record.pid, str(fault)) not in seen:
                seen.add((record.pid, str(fault)))
                found.append((record.t, names.get(record.pid, "?"), "fault", str(fault)))
            case _:
                pass
    return found


def write(path: Path, trace: Path) -> None:
    """Write the report of a merged trace, with data of the run's `summary.json` beside it.

    Raises BadTrace, OSError."""
    header, records = read(trace)
    rows = gathered(header, records)
    summary = _summary(trace, header, rows)
    path.write_text(html(header, summary, rows, important(*read(trace))), encoding="utf-8")


def html(header: Header, summary: Summary, rows: Chunk, lines: list[tuple[float, str, str, str]]) -> str:
    """Return the whole page."""
    title = f"{summary.app}, simulated"
    before = f"<h1>{escape(title)}</h1>\n{_verdict(summary)}\n{_facts(summary)}\n{_warnings(summary.robots)}"
    after = [
        "<h2>Robots</h2>",
        _robots(summary.robots),
        *_squads(summary),
        *_logs(summary.robots),
        "<h2>What happened</h2>",
        _lines(lines),
    ]
    if summary.reproduce:
        after += ["<h2>Reproduce this run</h2>", _pairs(summary.reproduce)]
    return page(f"{title}: {headline(summary)}", header, rows, before, "\n".join(after))


def _summary(trace: Path, header: Header, rows: Chunk) -> Summary:
    """Return the run's own summary if it fits this trace, otherwise one computed from the trace."""
    try:
        found = msgspec.json.decode((trace.parent / "summary.json").read_bytes(), type=Summary)
        if (found.app, found.program_hash, found.seed) == (header.app, header.program_hash, header.seed):
            return found
    except (OSError, msgspec.DecodeError):
        pass
    ends = [(row[0], row[2]) for row in rows["marks"] if row[1] == "end"]
    duration, ended = ends[0] if ends else (max((row[1] for row in rows["poses"]), default=0.0), "interrupted")
    near = min(rows["near"], key=lambda row: float(row[1]), default=None)
    closest = Closest(near[1], near[0], (0, 1)) if near else None
    pair = [who if isinstance(who, str) else header.robots[who].name for who in near[2:]] if near else []
    outcome = RunResult(header.started, ended, 0.0, duration, [], closest, 0.0, 0, 0, names=tuple(pair))
    return summarise(*read(trace), outcome)


def _verdict(summary: Summary) -> str:
    why, left_open, _ = summary.why.partition(LEFT_OPEN)
    colour = AMBER if left_open else COLOURS[summary.verdict]
    others = [violation_text(violation) for violation in summary.violations if violation_text(violation) not in why]
    more = "".join(f"<p>{escape(text)}</p>" for text in others[:MOST_VIOLATIONS])
    return (
        f'<div class="verdict" style="border-color:{colour}">'
        f'<strong style="color:{colour}">{escape(headline(summary).capitalize())}</strong>'
        f"<p>{escape(why)}</p>{more}{_properties(summary.properties)}</div>"
    )


def _properties(found: Sequence[Verdict]) -> str:
    """Return the verdicts of properties as HTML; a long list is folded."""
    counts = Counter(each.outcome for each in found)
    head = "properties: " + ", ".join(f"{count} {outcome}" for outcome, count in counts.items())
    return _folded(head, [(found_text(each), CLASSES[each.outcome]) for each in found]) if found else ""


def _warnings(robots: list[RobotSummary]) -> str:
    """Return the warnings and stalls of robots as HTML."""
    found = sorted(
        [(each.since, warned(robot.name, each)) for robot in robots for each in robot.warnings]
        + [(each.since, stalled(robot.name, each)) for robot in robots for each in robot.stalls]
    )
    head = f"{len(found)} warning{'s' if len(found) > 1 else ''} by robots"
    lines = [(text, "") for _, text in found[:MOST_WARNINGS]]
    if more := len(found) - len(lines):
        lines.append((f"{more} more are in summary.txt", "dim"))
    return f'<div class="verdict" style="border-color:{AMBER}">{_folded(head, lines)}</div>' if found else ""


def _folded(head: str, lines: Sequence[tuple[str, str]]) -> str:
    """Return lines, each with its CSS class, below a heading; unfolded if there are few."""
    rows = "".join(f'<li class="{kind}">{escape(text)}</li>' for text, kind in lines)
    return f"<details{' open' if len(lines) <= FEW else ''}><summary>{escape(head)}</summary><ul>{rows}</ul></details>"


def _facts(summary: Summary) -> str:
    facts = {"mission": f"{summary.duration:.1f} of {summary.duration_asked:g} s, seed {summary.seed}"}
    if summary.min_separation:
        found = summary.min_separation
        when = "every physics step of the run" if summary.steps else "the poses of the trace"
        asked = f"; at least {summary.min_separation_asked:g} m asked" if summary.min_separation_asked else ""
        facts["closest"] = (
            f"{found.robots[0]} and {found.robots[1]}, {found.distance:.3f} m at {found.time:.2f} s{asked} "
            f"(in space, between the robots' reference points, at {when})"
        )
    facts["collisions"] = str(summary.collisions)
    if summary.steps:
        facts["world"] = (
            f"real-time factor {summary.real_time_factor:.3f}; {summary.late_steps} of {summary.steps} steps late, "
            f"{summary.late_in_mission} of them in the mission"
        )
    if summary.host_waits:
        facts["host"] = waits(summary.host_waits)
    return _pairs(facts)


def _pairs(facts: Mapping[str, str]) -> str:
    return "<dl>" + "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in facts.items()) + "</dl>"


def _robots(robots: list[RobotSummary]) -> str:
    head = (
        "pid",
        "robot",
        "target",
        "start (m)",
        "final (m)",
        "path (m)",
        "rounds",
        "events",
        "skipped",
        "faults",
        "late",
    )
    numeric = {0, 5, 6, 9, 10}
    rows = ["".join(f"<th{_class(k in numeric)}>{word}</th>" for k, word in enumerate(head))]
    for r in robots:
        skips = "<br>".join(f"{escape(reason)} {count}" for reason, count in sorted(r.skips.items())) or "0"
        events = "<br>".join(f"{escape(name)} {count}" for name, count in sorted(r.events.items())) or "0"
        fault = f'<span class="bad">{r.faults}</span>' if r.faults else "0"
        cells = (
            str(r.pid), escape(r.name), escape(r.target), place(r.start), place(r.final), f"{r.path_length:.2f}",
            str(r.rounds), events, skips, fault, str(r.late_rounds),
        )  # fmt: skip
        rows.append("".join(f"<td{_class(k in numeric, k in (3, 4))}>{cell}</td>" for k, cell in enumerate(cells)))
    return '<div class="wide"><table>' + "".join(f"<tr>{row}</tr>" for row in rows) + "</table></div>"


def _squads(summary: Summary) -> list[str]:
    """Return links to the reports of squads, which are beside this one."""
    found = squads_of(summary).items()
    links = [f'<a href="{escape(name)}/report.html">{escape(name)}</a>: {escape(verdict)}' for name, verdict in found]
    return [f"<p>Reports of the squads: {', '.join(links)}</p>"] if links else []


def _class(number: bool, position: bool = False) -> str:
    return ' class="n"' if number else ' class="p"' if position else ""


def _logs(robots: list[RobotSummary]) -> list[str]:
    found = []
    for robot in robots:
        if robot.waiting_for:
            found.append(f"<p>{escape(robot.name)} was at: {escape(robot.waiting_for)}</p>")
        if robot.last_lines:
            log = escape("\n".join(robot.last_lines))
            found.append(f"<p>The last lines of {escape(robot.name)}'s log:</p><pre>{log}</pre>")
    return found


def _lines(lines: list[tuple[float, str, str, str]]) -> str:
    rows = ['<th class="n">time (s)</th><th>robot</th><th>what</th><th></th>']
    for t, robot, kind, text in lines:
        bad = ' class="bad"' if kind in BAD or (kind == "monitor" and ": violated" in text) else ""
        rows.append(
            f'<td class="n">{seconds(t)}</td><td>{escape(robot)}</td><td{bad}>{escape(kind)}</td>'
            f"<td>{escape(text)}</td>"
        )
    more = '<p class="dim">Not all of it; the rest is in trace.jsonl.</p>' if len(lines) >= MOST_LINES else ""
    return (
        '<div class="wide"><table class="events">'
        + "".join(f"<tr>{row}</tr>" for row in rows)
        + "</table></div>"
        + more
    )
