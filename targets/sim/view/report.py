"""The report of a run: one HTML file that shows all of it, without a network, scripts or other files."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterable, Mapping
from html import escape
from pathlib import Path

from targets.sim.summary import RobotSummary, Summary, place, told
from targets.sim.trace import Header, Log, Phase, Record, Round, Violation, fault_text

MOST_LINES = 200  # of events and log lines
COLOURS = {"held": "#1B7F4B", "violated": "#B00020", "interrupted": "#8A5A00", "not started": "#B00020"}
STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #1d1d1f; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; margin-bottom: .3rem; } h2 { font-size: 1.15rem; margin-top: 2.2rem; }
.verdict { border-left: .5rem solid; padding: .6rem 1rem; background: #f6f6f7; }
.verdict strong { font-size: 1.25rem; } .verdict p { margin: .2rem 0 0; }
table { border-collapse: collapse; width: 100%; font-size: .9rem; } .wide { overflow-x: auto; }
th, td { text-align: left; padding: .3rem .8rem .3rem 0; border-bottom: 1px solid #ddd; vertical-align: top; }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; } td.p { white-space: nowrap; }
img { max-width: 100%; display: block; } figure { margin: 1.2rem 0; }
pre { background: #f6f6f7; padding: .8rem; overflow-x: auto; font-size: .85rem; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .2rem 1.2rem; } dt { color: #666; } dd { margin: 0; }
.bad { color: #B00020; } .dim { color: #666; }
@media print { body { margin: 0; } figure { break-inside: avoid; } }
"""


def important(header: Header, records: Iterable[Record]) -> list[tuple[float, str, str, str]]:
    """What the report tells of the trace: t, robot, kind and text of all violations, and the first MOST_LINES of
    changed phases, warnings, errors and each robot's different faults."""
    names = {robot.pid: robot.name for robot in header.robots}
    seen: set[tuple[int, str]] = set()
    phases: dict[int, str] = {}
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
            case Log() if record.level != "info":
                found.append((record.t, names.get(record.pid, "?"), record.level, record.message))
            case Round(fault=fault) if fault is not None and (record.pid, fault_text(fault)) not in seen:
                seen.add((record.pid, fault_text(fault)))
                found.append((record.t, names.get(record.pid, "?"), "fault", fault_text(fault)))
            case _:
                pass
    return found


def write(
    path: Path,
    summary: Summary,
    lines: list[tuple[float, str, str, str]],
    pictures: Mapping[str, Path],
    reproduce: Mapping[str, str],
) -> None:
    """`pictures` are caption -> PNG file, `reproduce` what one needs to do it again, by name. Raises OSError."""
    path.write_text(html(summary, lines, pictures, reproduce), encoding="utf-8")


def html(
    summary: Summary,
    lines: list[tuple[float, str, str, str]],
    pictures: Mapping[str, Path],
    reproduce: Mapping[str, str],
) -> str:
    """The whole page."""
    title = escape(f"{summary.app}, simulated")
    parts = [
        f"<h1>{title}</h1>",
        _verdict(summary),
        "<h2>The fleet</h2>",
        _facts(summary),
        "<h2>Robots</h2>",
        _robots(summary.robots),
        *_logs(summary.robots),
        "<h2>Pictures</h2>",
        *(_picture(caption, file) for caption, file in pictures.items()),
        "<h2>What happened</h2>",
        _lines(lines),
        "<h2>To do it again</h2>",
        _pairs(reproduce),
        '<p class="dim">Agents run in real time on this host: the same seed gives the same world and the same sensor '
        "noise, but not the same timing of processes and datagrams.</p>",
    ]
    policy = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{title}: {escape(summary.verdict)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n"
        + "\n".join(parts)
        + "\n</body>\n</html>\n"
    )


def _verdict(summary: Summary) -> str:
    more = "".join(f"<p>{escape(told(v))}</p>" for v in summary.violations[1:20])
    return (
        f'<div class="verdict" style="border-color:{COLOURS[summary.verdict]}">'
        f'<strong style="color:{COLOURS[summary.verdict]}">{escape(summary.verdict.capitalize())}</strong>'
        f"<p>{escape(summary.why)}</p>{more}</div>"
    )


def _facts(summary: Summary) -> str:
    facts = {"mission": f"{summary.duration:.1f} of {summary.duration_asked:g} s, seed {summary.seed}"}
    if summary.min_separation:
        found = summary.min_separation
        asked = f"; at least {summary.min_separation_asked:g} m asked" if summary.min_separation_asked else ""
        facts["closest"] = (
            f"{found.robots[0]} and {found.robots[1]}, {found.distance:.3f} m at {found.time:.2f} s{asked} "
            "(in space, between the robots' reference points, at every physics step of the run)"
        )
    facts["collisions"] = str(summary.collisions)
    facts["world"] = (
        f"real-time factor {summary.real_time_factor:.3f}; {summary.late_steps} of {summary.steps} steps late"
    )
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


def _picture(caption: str, file: Path) -> str:
    data = b64encode(file.read_bytes()).decode("ascii")
    return f'<figure><img alt="{escape(caption)}" src="data:image/png;base64,{data}"></figure>'


def _lines(lines: list[tuple[float, str, str, str]]) -> str:
    rows = ['<th class="n">time (s)</th><th>robot</th><th>what</th><th></th>']
    for t, robot, kind, text in lines:
        bad = ' class="bad"' if kind not in ("starting", "joining", "running", "resting", "rested", "warning") else ""
        rows.append(
            f'<td class="n">{t:.2f}</td><td>{escape(robot)}</td><td{bad}>{escape(kind)}</td><td>{escape(text)}</td>'
        )
    more = '<p class="dim">Not all of it; the rest is in trace.jsonl.</p>' if len(lines) >= MOST_LINES else ""
    return '<div class="wide"><table>' + "".join(f"<tr>{row}</tr>" for row in rows) + "</table></div>" + more
