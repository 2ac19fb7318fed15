"""Summary of a run: figures per robot and for the fleet, computed from its trace, as JSON and as text."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Literal

import msgspec
from msgspec import UNSET, UnsetType

from koordgen.runtime.program.runner import name_of
from koordgen.runtime.trace.schema import (
    Cause,
    End,
    Header,
    LogLine,
    Monitor,
    PoseRecord,
    Round,
    Stall,
    TraceRecord,
    Violation,
)
from koordgen.runtime.trace.schema import Verdict as Found
from targets.sim.base.bodies import Vector
from targets.sim.run.run import RunResult
from targets.sim.trace.files import was_late
from targets.sim.trace.monitor_reports import Monitored, MonitorSummary
from targets.sim.trace.monitor_reports import as_text as monitor_text

Verdict = Literal["held", "violated", "host overloaded", "interrupted", "not started"]


LEFT_OPEN = "; not judged to the end: "  # separates a run's reason from properties that were not fully judged
MOST_WARNINGS = 50  # distinct warnings kept per robot
AGAIN = "run the simulation again with --lockstep, or when the host has less to do"


class Stalled(msgspec.Struct):
    """Period in which a robot had no path to its target.

    `since` and `seconds` (s); `over`: it ended before the mission did; `why`: the last reason."""

    since: float
    seconds: float
    over: bool
    why: str


class Warned(msgspec.Struct):
    """Warning of a robot's agent, such as a command clamped at the geofence or a setpoint refused.

    `since`: first time (s); `text`: its text then. Warnings that differ only in numbers are counted together."""

    since: float
    text: str
    level: str
    times: int = 1


class RobotSummary(msgspec.Struct):
    """Figures of one robot. Positions (m, local ENU) are the truth.

    `start`: at the beginning of the run. `final`: at the mission's end. `stop`: after landing or braking.
    `path_length`, rounds, events, skips and faults: from round 1 to the mission's end. Of several applications, each
    counts its own events, skips and faults in a round."""

    name: str
    pid: int
    target: str
    start: Vector | None = None
    final: Vector | None = None
    stop: Vector | None = None
    path_length: float = 0.0
    rounds: int = 0
    events: dict[str, int] = {}
    skips: dict[str, int] = {}
    faults: int = 0
    first_fault: str | None = None
    late_rounds: int = 0
    status: int | None = None
    waiting_for: str | None = None
    last_lines: list[str] = []
    stalls: list[Stalled] = []
    warnings: list[Warned] = []


class Separation(msgspec.Struct):
    """Smallest distance of two robots over the whole run.

    Checked at every physics step (240 Hz), in space, between reference points."""

    distance: float
    time: float
    robots: tuple[str, str]


class Summary(msgspec.Struct):
    app: str
    program_hash: str
    seed: int
    duration_asked: float
    duration: float
    verdict: Verdict
    why: str
    violations: list[Violation]
    properties: list[Found]
    causes: list[Cause]  # faults that were injected
    robots: list[RobotSummary]
    min_separation: Separation | None
    min_separation_asked: float
    collisions: int
    real_time_factor: float
    late_steps: int
    steps: int
    late_in_mission: int = 0  # of the late steps
    monitors: list[MonitorSummary] = []  # violations reported by the robots' own monitors
    watching: float = 0.0  # share of the run's time that judging its properties took
    shares: dict[str, float] = {}  # shares of the processor's time, by part; empty in real time
    host_waits: dict[str, float] = {}  # s for which each robot's agent and the simulator waited for a core; real time
    reproduce: dict[str, str] = {}  # command and versions that repeat the run
    squads: dict[str, str] | UnsetType = UNSET  # squad -> verdict on its own fleet; only in a run with squads


def summarise(header: Header, records: Iterable[TraceRecord], result: RunResult) -> Summary:
    """Summarise a merged trace in one pass."""
    tallies = {
        robot.pid: _Tally(RobotSummary(robot.name, robot.pid, robot.target), header.delta) for robot in header.robots
    }
    ended = False
    violations: list[Violation] = []
    properties: list[Found] = []
    causes: list[Cause] = []
    names = {robot.pid: robot.name for robot in header.robots}
    monitored = Monitored(names, header.delta)
    for record in records:
        match record:
            case Monitor() if not ended:
                monitored.add(record)
            case PoseRecord() | Round() | Stall() | LogLine() if record.pid in tallies:
                tallies[record.pid].add(record, ended)
            case Violation():
                violations.append(record)
            case Found():
                properties.append(record)
            case Cause():
                causes.append(record)
            case End():
                ended = True
                for tally in tallies.values():
                    tally.end(record.t)
            case _:
                pass
    robots = [tally.summary for tally in tallies.values()]
    for robot in robots:
        robot.status = result.statuses.get(robot.name)
        robot.waiting_for = result.waiting.get(robot.name)
        robot.last_lines = result.last_lines.get(robot.name, [])
    verdict, why = _verdict(result, violations, properties)
    return Summary(
        app=header.app,
        program_hash=header.program_hash,
        seed=header.seed,
        duration_asked=header.duration,
        duration=result.duration if result.started else 0.0,
        verdict=verdict,
        why=why,
        violations=violations,
        properties=properties,
        monitors=monitored.beside(properties),
        causes=causes,
        robots=robots,
        min_separation=_separation(result, dict(enumerate(result.names)) or names),
        min_separation_asked=header.min_separation,
        collisions=sum(v.what == "collision" for v in violations),
        real_time_factor=result.real_time_factor,
        late_steps=result.late_steps,
        late_in_mission=result.late_in_mission,
        steps=result.steps,
        shares=result.shares,
        host_waits=result.host_waits,
    )


def add_fleet(summary: Summary, name: str, inner: Summary) -> None:
    """Add the properties of the inner fleet `name` and their violations to the summary of a run with squads."""
    found = [msgspec.structs.replace(each, name=f"{name}: {each.name}") for each in inner.properties]
    known = {} if summary.squads is UNSET else summary.squads
    summary.squads = {**known, name: headline(inner)}
    summary.properties += [msgspec.structs.replace(each, robots=_full(name, each.robots)) for each in found]
    own = [
        msgspec.structs.replace(each, robots=_full(name, each.robots), detail=f"{name}: {each.detail}")
        for each in inner.violations
        if each.what == "property"
    ]
    summary.violations = sorted([*summary.violations, *own], key=lambda violation: violation.t)
    judged = [each for each in own if not each.host]  # the host did not cause them
    if summary.verdict in ("held", "host overloaded") and judged:
        summary.verdict, summary.why = "violated", violation_text(judged[0])
    elif summary.verdict == "held" and own:
        summary.verdict, summary.why = "host overloaded", _overloaded(violation_text(own[0]))
    elif summary.verdict == "held" and LEFT_OPEN in inner.why:
        joint = "; " if LEFT_OPEN in summary.why else LEFT_OPEN
        summary.why += f"{joint}{name}: {inner.why.partition(LEFT_OPEN)[2]}"


def squads_of(summary: Summary) -> dict[str, str]:
    """Return the verdict on the fleet of each squad, by the squad's name."""
    return {} if summary.squads is UNSET else summary.squads


def _full(fleet: str, robots: tuple[str, ...]) -> tuple[str, ...]:
    return tuple([f"{fleet}.{robot}" for robot in robots])


def _separation(result: RunResult, names: dict[int, str]) -> Separation | None:
    closest = result.closest
    if closest is None:
        return None
    one, other = closest.pids
    return Separation(round(closest.distance, 4), closest.time, (names[one], names[other]))


class _Tally:
    def __init__(self, summary: RobotSummary, delta: float) -> None:
        summary.events, summary.skips, summary.stalls, summary.warnings = {}, {}, [], []
        self._warned: dict[str, Warned] = {}
        self.summary = summary
        self._delta = delta
        self._last: Vector | None = None
        self._round, self._application = 0, ""

    def add(self, record: PoseRecord | Round | Stall | LogLine, ended: bool) -> None:
        """Add a record of the robot; `ended`: the mission is over."""
        match record:
            case PoseRecord():
                self.pose(record, ended)
            case LogLine():
                self.log(record)
            case Round() if not ended:
                self.round(record)
            case Stall() if not ended:
                self.stall(record)

    def pose(self, pose: PoseRecord, ended: bool) -> None:
        own = self.summary
        own.start = own.start or pose.position
        own.stop = pose.position
        if not ended:
            own.final = pose.position
            if pose.t >= 0 and self._last is not None:
                own.path_length += math.dist(self._last, pose.position)
        self._last = pose.position

    def log(self, record: LogLine) -> None:
        """Count a warning or an error by its text without numbers. Stall messages are reported as stalls."""
        own = self.summary
        if record.level == "info" or (own.stalls and record.message.endswith(own.stalls[-1].why)):
            return
        kind = re.sub(r"[-\d.]+", "", record.message)
        if kind in self._warned:
            self._warned[kind].times += 1
        elif len(self._warned) < MOST_WARNINGS:
            self._warned[kind] = Warned(record.t, record.message.strip(), record.level)
            own.warnings.append(self._warned[kind])

    def stall(self, record: Stall) -> None:
        own = self.summary.stalls
        if own and not own[-1].over:
            own.pop()
        since = round(record.t - record.lasted, 3)
        own.append(Stalled(since, record.lasted, record.state == "ends", record.why))

    def end(self, t: float) -> None:
        """Close open stalls at the mission's end."""
        for stalled in self.summary.stalls:
            if not stalled.over:
                stalled.seconds = round(t - stalled.since, 3)

    def round(self, record: Round) -> None:
        own = self.summary
        self._application = self._application or record.application
        if record.application == self._application:  # count a round once, though each application has a record of it
            own.rounds += 1
            slept = max(0, record.round - self._round - 1) if self._round else 0
            own.late_rounds += slept + was_late(record, self._delta)
            self._round = record.round
        if record.fault is not None:
            own.faults += 1
            own.first_fault = own.first_fault or str(record.fault)
        elif record.skipped is not None:
            reason = name_of(record.skipped)
            own.skips[reason] = own.skips.get(reason, 0) + 1
        elif record.event is not None:
            own.events[record.event] = own.events.get(record.event, 0) + 1


def _verdict(result: RunResult, violations: list[Violation], properties: list[Found]) -> tuple[Verdict, str]:
    own = [violation for violation in violations if not violation.host]
    first = violation_text((own or violations)[0]) if violations else ""
    if result.ended == "interrupted":
        return "interrupted", "interrupted by the user" + (f"; before that, {first}" if first else "")
    if result.ended == "timeout":
        waiting = "; ".join(f"{name}: {what}" for name, what in result.waiting.items())
        return "not started", f"round 1 did not begin: {waiting}"
    if own:
        return "violated", first
    if violations:
        return "host overloaded", _overloaded(first)
    how = "all robots ended by themselves" if result.ended == "stopped" else "the whole duration was simulated"
    left = "; ".join(f"{_named(found)}, {found.outcome}{_since(found)}" for found in properties if _open(found))
    return "held", f"{how}, and nothing was violated" + (f"{LEFT_OPEN}{left}" if left else "")


def _overloaded(first: str) -> str:
    """Return why a run with an overloaded host judges nothing. `first`: the first violation."""
    return f"{first}. The run does not judge the program: {AGAIN}"


def _open(found: Found) -> bool:
    """Return whether the run leaves a property undecided; False for an axiom, which no run judges."""
    return found.outcome in ("out of model", "unchecked") and found.of != "axiom"


def _since(found: Found) -> str:
    return "" if found.since is None else f" since {seconds(found.since)} s"


def _named(found: Found) -> str:
    """Return a property's name and line."""
    return f"{found.of} {found.name} ({found.line})" if found.name else f"{found.of} ({found.line})"


def found_text(found: Found) -> str:
    """Return the verdict on a property, in one line."""
    detail = f": {found.detail}" if found.detail else f", observations: {found.observations}"
    return f"{found.outcome.upper()}{_since(found)}: {_named(found)}{detail}"


def headline(summary: Summary) -> str:
    """Return the verdict in one to three words. "held in part": not all properties could be judged."""
    return "held in part" if summary.verdict == "held" and any(map(_open, summary.properties)) else summary.verdict


def seconds(t: float) -> str:
    """Format a time for display; never -0.00."""
    return f"{round(t, 2) + 0.0:.2f}"


def violation_text(violation: Violation) -> str:
    """Return a violation as one sentence."""
    who = " ".join([f"at {seconds(violation.t)} s", *filter(None, [" and ".join(violation.robots)])])
    host = f"; {violation.host}" if violation.host else ""
    if violation.line:
        return f"{who}: {violation.detail} ({violation.line}){host}"
    verb = " " if violation.what in ("ended", "not_stopped") else f": {violation.what}, "
    return f"{who}{verb}{violation.detail}{host}"


def stalled(robot: str, stall: Stalled) -> str:
    """Return a stall as one line."""
    until = f"for {stall.seconds:.1f} s" if stall.over else f"until the end ({stall.seconds:.1f} s)"
    return f"{robot} from {seconds(stall.since)} s {until}: {stall.why}"


def waits(seconds_of: Mapping[str, float]) -> str:
    """Return a sentence on how long processes waited for a processor core."""
    longest = max(seconds_of, key=seconds_of.__getitem__)
    whole = sum(seconds_of.values())
    return f"processes waited {whole:.2f} s for a processor core, {longest} the longest: {seconds_of[longest]:.2f} s"


def warned(robot: str, warning: Warned) -> str:
    """Return a warning as one line."""
    often = f" ({warning.times} times)" if warning.times > 1 else ""
    return f"{robot} at {seconds(warning.since)} s: {warning.text}{often}"


def _cause_text(cause: Cause) -> str:
    """Return an injected fault as one line."""
    who = f" ({', '.join(cause.robots)})" if cause.robots else ""
    text = f"at {seconds(cause.t)} s {cause.what}{who}"
    return text + (f": {cause.detail}" if cause.detail else "") + (f", for {cause.lasts:g} s" if cause.lasts else "")


def write(summary: Summary, folder: Path) -> None:
    """Write `summary.json` and `summary.txt`. Raises OSError."""
    text = msgspec.json.format(msgspec.json.encode(summary), indent=2)
    (folder / "summary.json").write_bytes(text + b"\n")
    (folder / "summary.txt").write_text(as_text(summary), encoding="utf-8")


def as_text(summary: Summary) -> str:
    """Return the summary as text."""
    lines = [
        f"{summary.app}: {headline(summary).upper()}: {summary.why}",
        f"seed {summary.seed}, {summary.duration:.1f} of {summary.duration_asked:g} s, program {summary.program_hash}",
        "",
        *_table(summary),
        "",
        *_details(summary),
        *[f"squad {name}: {found}; see {name}/summary.txt" for name, found in squads_of(summary).items()],
        *_properties(summary),
    ]
    if summary.min_separation:
        found = summary.min_separation
        asked = f", at least {summary.min_separation_asked:g} m asked" if summary.min_separation_asked else ""
        lines.append(
            f"closest: {' and '.join(found.robots)}, {found.distance:.3f} m at {found.time:.2f} s{asked}"
            " (in space, between reference points, at 240 Hz)"
        )
    lines.append(f"collisions: {summary.collisions}")
    late = f"{summary.late_steps} late, {summary.late_in_mission} of them in the mission"
    lines.append(f"world: {summary.steps} steps, {late}, real-time factor {summary.real_time_factor:.3f}")
    if summary.host_waits:
        lines.append(f"the host: {waits(summary.host_waits)}")
    if summary.shares:
        parts = (f"{part} {share:.0%}" for part, share in summary.shares.items())
        lines.append(f"the processor's time: {', '.join(parts)}")
    stalls = [stalled(robot.name, each) for robot in summary.robots for each in robot.stalls]
    if stalls:
        lines += ["", "robots without a path to their target:", *(f"  {line}" for line in stalls)]
    warnings = [warned(robot.name, each) for robot in summary.robots for each in robot.warnings]
    if warnings:
        lines += ["", "robots warned:", *(f"  {line}" for line in warnings)]
    if len(summary.violations) > 1:
        lines += [
            "",
            f"all {len(summary.violations)} violations:",
            *(f"  {violation_text(v)}" for v in summary.violations),
        ]
    if summary.causes:
        lines += ["", "injected faults:", *(f"  {_cause_text(cause)}" for cause in summary.causes)]
    for robot in summary.robots:
        if robot.last_lines:
            lines += ["", f"the last lines of {robot.name}'s log:", *(f"  {line}" for line in robot.last_lines)]
    return "\n".join(lines) + "\n"


def _table(summary: Summary) -> list[str]:
    rows = [("pid", "robot", "target", "start", "final", "path m", "rounds", "events", "skips", "faults", "late")]
    rows += [
        (
            str(r.pid), r.name, r.target, place(r.start), place(r.final), f"{r.path_length:.2f}", str(r.rounds),
            str(sum(r.events.values())), str(sum(r.skips.values())), str(r.faults), str(r.late_rounds),
        )
        for r in summary.robots
    ]  # fmt: skip
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]


def _properties(summary: Summary) -> list[str]:
    """Return one line per property, then the violations reported by monitors.

    None for a program without any."""
    lines = [found_text(found) for found in summary.properties]
    took = [f"judging them took {summary.watching:.1%} of the time"] if lines else []
    own = ["", "the robots' own monitors:"] if summary.monitors else []
    own += [f"  {monitor_text(found)}" for found in summary.monitors]
    return (["", "properties:", *(f"  {line}" for line in lines + took)] if lines else []) + own


def _details(summary: Summary) -> list[str]:
    lines = []
    for robot in summary.robots:
        parts = [f"{name} {count}" for name, count in sorted(robot.events.items())]
        parts += [f"skipped ({reason}) {count}" for reason, count in sorted(robot.skips.items())]
        if robot.first_fault:
            parts.append(f"first fault {robot.first_fault}")
        if robot.status not in (0, None):
            parts.append(f"ended with status {robot.status}")
        lines.append(f"{robot.name}: {', '.join(parts) or 'no round'}")
    return lines


def place(position: Vector | None) -> str:
    """Format a position for a table."""
    if position is None:
        return "-"
    return "({:.2f}, {:.2f}, {:.2f})".format(*(round(c, 2) + 0.0 for c in position))  # + 0.0: no -0.00
