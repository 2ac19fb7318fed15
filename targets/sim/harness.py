"""Command line of the sim bundle: runs the fleet and writes trace, summary, pictures and report."""

from __future__ import annotations

import argparse
import errno
import hashlib
import importlib.util
import json
import math
import os
import platform
import re
import shlex
import shutil
import sys
import time
import traceback
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msgspec.structs import replace

from koordgen.runtime.ops.host import install_requirements, pip_install
from targets.sim.base.fleets import SimulatedFleet, fleets_of
from targets.sim.base.folder import GIVEN, SOURCE, ForeignFolder, RunFolder
from targets.sim.base.scenario import FILE, BadScenario, Scenario, load
from targets.sim.base.schedule import CONDITIONS, DURATION, MOST_DELAY, PROBABILITIES, Schedule
from targets.sim.physics.contacts import NoEngine, choose
from targets.sim.run import faults
from targets.sim.run.start_perturbation import scattered

if TYPE_CHECKING:
    from koordgen.runtime.trace.schema import Header
    from targets.sim.follow.guide import ReplayGuide
    from targets.sim.follow.plan import ReplayPlan
    from targets.sim.judging.summary import Summary
    from targets.sim.judging.watch import Watcher
    from targets.sim.judging.windows import Windows
    from targets.sim.run.progress import Progress
    from targets.sim.run.run import Companion, Run, RunResult
    from targets.sim.view.foxglove.stream import Streamed
    from targets.sim.view.web.control import ManualFaults
    from targets.sim.view.web.live import Live, PaceLimit

HELD, BAD_FILES, USAGE, VIOLATED, SURROUNDINGS, HOST, INTERNAL, INTERRUPTED = 0, 1, 2, 3, 5, 6, 70, 130
STATUS = {"held": HELD, "violated": VIOLATED, "interrupted": INTERRUPTED, "not started": SURROUNDINGS}
REAL_TIME = (
    "real time on this host: the same seed gives the same world and the same sensor noise, but not the same timing of "
    "processes and datagrams"
)
EXTRAS = {"foxglove-sdk": "'koordgen[foxglove]'"}  # optional package -> the extra that installs it
FOXGLOVE_PORT = 8765  # Foxglove's default port
NEEDED = ("numpy", "matplotlib")  # and a contact engine


def main(root: Path, argv: list[str] | None = None) -> int:
    """Run the bundle at `root`. Return the exit status. Usage errors raise SystemExit(2)."""
    parser = _parser(root, sys.argv[1:] if argv is None else argv)
    options = parser.parse_args(argv)
    if options.pace and not options.lockstep:
        parser.error("--pace needs --lockstep; a real-time run cannot be slowed")
    try:
        scenario = scattered(replace(load(root, options.settings), gui=options.gui), options.seed)
        out: Path = options.out or Path(f"run-{scenario.app}")
        scenario = replace(scenario, harness={**scenario.harness, "engine": choose(scenario.engine)})
        plan = _plan(scenario, options)
        _require(scenario, placed=plan is not None)
        _check_windows(scenario, options.windows)
        schedule, told = _schedule(scenario, options)
        if options.check:
            return _check(root, scenario)
        from targets.sim.view.foxglove import stream
        from targets.sim.view.web import live

        # Start the views first: if one fails, the results of an earlier run must survive.
        offer: dict[str, Any] = {"lockstep": options.lockstep, "faults": plan is None}
        if scenario.fleets:
            offer["robots"] = [robot.name for robot in scenario.robots]
        header = _header(fleets_of(scenario)[0], plan, options)
        with (
            live.watched(header, options.live, offer) as view, stream.streamed(header, options.foxglove) as streamed,
            RunFolder(out, [fleet.name for fleet in scenario.fleets[1:]]) as folder,
        ):  # fmt: skip
            if told is not None:
                (folder / "faults.json").write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")
            return _run(root, scenario, (schedule, told), plan, folder, options, (view, streamed))
    except BadScenario as error:
        return _fail(BAD_FILES, str(error), error.hint)
    except (ForeignFolder, NoEngine) as error:
        return _fail(SURROUNDINGS, str(error), error.hint)
    except ModuleNotFoundError as error:
        hint = pip_install(EXTRAS[error.name]) if error.name in EXTRAS else install_requirements(root)
        return _fail(SURROUNDINGS, f"the Python package {error.name!r} is missing", hint)
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        where = f"{error.filename}: " if error.filename else ""
        text = (
            "the disk is full; the run was ended, and its results are incomplete" if full else error.strerror or error
        )
        return _fail(SURROUNDINGS, f"{where}{text}", "make room and run it again" if full else "")
    except KeyboardInterrupt:
        return _fail(INTERRUPTED, "interrupted", "")
    except Exception:
        traceback.print_exc()
        return _fail(INTERNAL, "internal error of koordgen; please report it with the lines above", "")


def _parser(root: Path, argv: list[str]) -> argparse.ArgumentParser:
    """Return the parser. Usage errors name the command that the user called, not the bundle."""
    key = "--invoked-as="
    invoked = next((word.removeprefix(key) for word in argv if word.startswith(key)), None)
    parser = argparse.ArgumentParser(
        prog=" ".join(invoked.split()[:2]) if invoked else f"python3 {root}",
        usage=invoked and invoked.replace("%", "%%"),
        description="Run the whole fleet on this host.",
        allow_abbrev=False,
    )
    parser.add_argument("--duration", type=_seconds, default=DURATION, metavar="S", help="mission time, default 30 s")
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N", help="seed of all randomness in the world, default 0"
    )
    parser.add_argument("--lockstep", action="store_true", help="run in one process, repeatable, as fast as possible")
    parser.add_argument("--out", type=Path, metavar="DIR", help="output folder, default run-<app>")
    parser.add_argument(
        "--settings", type=Path, metavar="FILE", help="JSON object that overrides the scenario's settings"
    )
    parser.add_argument("--scenario", type=Path, metavar="FILE", help="faults of the run, with their times")
    parser.add_argument(
        "--follow", type=Path, metavar="FILE", help="plan of a counterexample to replay, written by koordgen"
    )
    for name in CONDITIONS:
        what = "0 to 1" if name in PROBABILITIES else "seconds"
        parser.add_argument(
            f"--{name}", type=_condition(name), metavar="X", help=f"of all links between robots, {what}"
        )
    later = "no report and no pictures; `koordgen report` and `export` create them later"
    parser.add_argument("--no-report", action="store_true", help=later)
    windows = "record every window of every robot in windows.jsonl, of this application if the fleet has several"
    parser.add_argument("--windows", nargs="?", const="", metavar="APPLICATION", help=windows)
    parser.add_argument("--gui", action="store_true", help="show PyBullet's window (MuJoCo has none: see --live)")
    parser.add_argument("--check", action="store_true", help="check the bundle and its packages; run nothing")
    parser.add_argument("--invoked-as", metavar="TEXT", help="the command to name in the report, if not this one")
    live = "show the run on a page at 127.0.0.1, on PORT or any free one"
    parser.add_argument("--live", type=_port, nargs="?", const=0, metavar="PORT", help=live)
    foxglove = f"stream the run to Foxglove at ws://127.0.0.1:PORT, default {FOXGLOVE_PORT}; 0: any free one"
    parser.add_argument("--foxglove", type=_port, nargs="?", const=FOXGLOVE_PORT, metavar="PORT", help=foxglove)
    pace = "limit a lockstep run to this multiple of real time"
    parser.add_argument("--pace", type=_factor, metavar="FACTOR", help=pace)
    parser.add_argument("--quiet", action="store_true", help="no progress")
    return parser


def _condition(name: str) -> Callable[[str], float]:
    most = 1.0 if name in PROBABILITIES else MOST_DELAY

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not 0.0 <= value <= most:
            unit = "" if name in PROBABILITIES else " s"
            raise argparse.ArgumentTypeError(f"{name} is 0 to {most:g}{unit}, not {text}")
        return value

    return parse


def _seconds(text: str) -> float:
    return _positive(text, "duration; give seconds")


def _factor(text: str) -> float:
    return _positive(text, "pace; give times real time")


def _positive(text: str, what: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"{text} is no {what}, greater than 0")
    return value


def _port(text: str) -> int:
    if not (text.isdecimal() and int(text) <= 65535):
        raise argparse.ArgumentTypeError(f"{text} is no port; give 1 to 65535, or none for any free one")
    return int(text)


def _coloured(found: re.Match[str]) -> str:
    return f"{found[1]}\x1b[1;{32 if found[2] == 'HELD' else 31}m{found[2]}\x1b[0m"


def _print(text: str) -> None:
    """Print a result. A closed output is no error: the verdict is also the exit status."""
    if sys.stdout.isatty() and not os.environ.get("NO_COLOR"):
        text = re.sub(r"^(\S+: )(HELD|VIOLATED|HOST OVERLOADED)", _coloured, text)
    try:
        print(text, flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _fail(status: int, message: str, hint: str) -> int:
    print(f"error: {message}" + (f"\n  help: {hint}" if hint else ""), file=sys.stderr)
    return status


def _plan(scenario: Scenario, options: argparse.Namespace) -> ReplayPlan | None:
    """Return the plan to replay, with the options it implies: lockstep, and its own duration.

    Raises BadScenario."""
    if options.follow is None:
        return None
    from targets.sim.follow.plan import load as load_plan

    plan = load_plan(options.follow, scenario.program_hash, len(scenario.robots))
    options.lockstep, options.duration = True, (len(plan.rounds) + 2) * scenario.delta
    return plan


def _require(scenario: Scenario, placed: bool) -> None:
    """Fail now, not after the run, if a package is missing. `placed`: bodies may be anywhere."""
    from targets.sim.run import scene

    for name in NEEDED:
        if importlib.util.find_spec(name) is None:
            raise ModuleNotFoundError(name=name)
    if not placed:
        scene.check(scenario)


def _schedule(scenario: Scenario, options: argparse.Namespace) -> tuple[Schedule, Any]:
    """Return the faults of this run, and the plain values of the scenario file. Raises BadScenario."""
    names = [robot.name for robot in scenario.robots]
    found, told = faults.load(options.scenario, names) if options.scenario else (Schedule(), None)
    faults.check_times(found, options.duration)
    faults.check_robots(found, scenario.robots)
    faults.check_obstacles(found, len(scenario.obstacles))
    return faults.with_network(found, vars(options)), told


def _check_windows(scenario: Scenario, application: str | None) -> None:
    """Check the value of --windows: "" for the only application, None for no windows. Raises BadScenario."""
    names = [each.name for each in scenario.applications]
    if application is not None and application not in (names or [""]):
        hint = f"name one of {', '.join(names)}" if names else "give --windows without a name"
        wrong = f"no application {application!r}" if application else "several applications have windows"
        raise BadScenario(f"--windows: {wrong}", hint)


def _check(root: Path, scenario: Scenario) -> int:
    print(f"ok: {root / FILE}: {scenario.app}, {len(scenario.robots)} robots, delta {scenario.delta:g} s")
    for robot in scenario.robots:
        print(f"ok: {robot.name}: {robot.target}, {robot.body} with {robot.device}, {robot.bundle}")
    print(f"ok: packages {', '.join(NEEDED)}; contact engine {scenario.engine}")
    return HELD


def _run(
    root: Path, scenario: Scenario, wrong: tuple[Schedule, Any], plan: ReplayPlan | None, folder: Path,
    options: argparse.Namespace,
    views: tuple[Live | None, Streamed | None],
) -> int:  # fmt: skip
    from targets.sim.judging import summary
    from targets.sim.judging.host_load import HostLoad
    from targets.sim.run.fleet_run import FleetRun
    from targets.sim.run.progress import Progress

    view = views[0]
    progress = Progress(sys.stderr, options.quiet, free=options.lockstep)
    windows, guide = None, None
    if plan is not None:
        run, watchers, guide = _following(root, scenario, plan, folder, options, progress)
    else:
        run, watchers, windows = _made(root, scenario, folder, options, progress)
    given, paced = _steered(run, wrong, folder, options, view)
    shortest = min(fleet.scenario.delta for fleet in run.fleets)
    load = None if options.lockstep else HostLoad(shortest, set().union(*[each.moving for each in watchers]))
    run.companions += [each for each in (*views, load) if each]
    began = time.perf_counter()
    try:
        result = run.execute()
    finally:
        progress.finish()
    if load is not None:
        result.marks, result.host_waits = load.explained(result.marks, result.zero), load.totals
    found = _summarised(run, run.fleets[0], result, _header(run.fleets[0], plan, options))
    for each in run.companions:
        if isinstance(each, FleetRun) and each.fleet.name:
            own = each.result(result) if load is None else each.result(result, partial(load.explained, zero=0.0))
            inner = _summarised(run, each.fleet, own, _header(each.fleet, plan, options))
            summary.write(inner, folder / each.fleet.name)
            summary.add_fleet(found, each.fleet.name, inner)
    watched = sum(each.seconds for each in watchers)
    found.watching = round(watched / (time.perf_counter() - began), 4)
    if windows is not None:
        windows.write(folder, result.ended)
    if paced is not None and paced.waited:
        found.shares = {}  # shares of the time mean nothing if most of it was waiting
    found.reproduce = _reproduce(root, scenario, folder, options, given.count if given is not None else 0)
    summary.write(found, folder)
    left = folder if options.no_report else folder / "report.html"
    if not options.no_report:
        progress.step("drawing the report")
        for fleet in run.fleets:
            _report(folder / fleet.name)
    if view:
        view.close(f"{summary.headline(found)}: {found.why}. The report: {left.resolve()}")
    _print(summary.as_text(found))
    _print(f"{'run' if options.no_report else 'report'}: {left}")
    if guide is not None and result.ended != "interrupted":
        return _followed(guide, result)
    if found.verdict == "host overloaded":
        return _fail(HOST, "the host was overloaded, so this run does not judge the program", summary.AGAIN)
    return STATUS[found.verdict] if result.ended != "died" else VIOLATED


def _followed(guide: ReplayGuide, result: RunResult) -> int:
    status, message = guide.result(result)
    if status == INTERNAL:
        return _fail(
            status, message, "the agents' code disagrees with the program's semantics: please report it with the trace"
        )
    _print(message)
    return status


def _following(
    root: Path, scenario: Scenario, plan: ReplayPlan, folder: Path, options: argparse.Namespace, progress: Progress
) -> tuple[Run, list[Watcher], ReplayGuide]:
    """Return the run, its watchers and its guide, for a run that replays a plan."""
    from targets.sim.follow.conduct import ReplayLockstep
    from targets.sim.follow.guide import ReplayGuide
    from targets.sim.judging import watch
    from targets.sim.run.run import Run

    robots = tuple(robot.name for robot in scenario.robots)
    applications = watch.load_fleet(root, len(robots), [served for served, _, _ in scenario.drivers])
    watchers = [watch.Watcher(a.properties, robots, scenario.delta, None, a) for a in applications]
    shutil.copytree(root / SOURCE, folder / SOURCE)
    measured = {name for application in applications for name in application.properties.measured}
    guide = ReplayGuide(plan, scenario.robots, scenario.delta, measured, applications[0].fleet)
    run = Run(scenario, ReplayLockstep(scenario, root, folder, options.seed, guide), folder, options.duration, progress)
    run.companions += [*watchers, guide]
    return run, watchers, guide


def _made(
    root: Path, scenario: Scenario, folder: Path, options: argparse.Namespace, progress: Progress
) -> tuple[Run, list[Watcher], Windows | None]:
    """Return the run with its companions, ready to execute."""
    from targets.sim.judging.idle import IDLE_TIMEOUT, Idle
    from targets.sim.lockstep.run import Lockstep
    from targets.sim.realtime.realtime import RealTime
    from targets.sim.run.fleet_run import FleetRun
    from targets.sim.run.run import Run

    all_watchers, windows = [], None
    companions: list[Companion[Run]] = []
    fleets = fleets_of(scenario)
    for fleet in fleets:
        programs = fleet.programs(root)
        outer, wanted = len(fleets[0].names), None if fleet.name else options.windows
        watchers, found = _watchers(programs, fleet, outer, wanted, options.seed)
        windows = windows or found
        all_watchers += watchers
        shutil.copytree(programs / SOURCE, folder / fleet.name / SOURCE)
        beside: list[Any] = list(watchers)
        if not fleet.name:
            beside.append(Idle(fleet.names, scenario.number("idle_timeout", IDLE_TIMEOUT)))
        companions += [FleetRun(fleet, beside)] if scenario.fleets else beside
    conduct = Lockstep if options.lockstep else RealTime
    run = Run(scenario, conduct(scenario, root, folder, options.seed), folder, options.duration, progress)
    run.companions += companions
    return run, all_watchers, windows


def _watchers(
    programs: Path, fleet: SimulatedFleet, outer: int, windows: str | None, seed: int
) -> tuple[list[Watcher], Windows | None]:
    """Return the watchers of a fleet's applications, and the windows of the application that `windows` names.

    `outer`: number of robots of the outer fleet."""
    from targets.sim.judging import watch
    from targets.sim.judging.windows import Windows

    names, scenario = fleet.names, fleet.scenario
    applications = watch.load_fleet(programs, len(names), [served for served, _, _ in scenario.drivers], outer)
    recorded, of = None, next((a for a in applications if a.name == windows), None)
    if of is not None:
        recorded = Windows(of.properties, scenario, seed, of.members)
    found = [watch.Watcher(a.properties, names, scenario.delta, recorded if a is of else None, a) for a in applications]
    return found, recorded


def _summarised(run: Run, fleet: SimulatedFleet, result: RunResult, header: Header) -> Summary:
    """Write the merged trace of a fleet, and return the summary. `result`: the result of this fleet."""
    from targets.sim.judging import summary
    from targets.sim.run.run import poses_file
    from targets.sim.trace import files as trace

    merged, poses = run.folder / fleet.name / "trace.jsonl", poses_file(run.folder, fleet)
    agents = [agent.trace_file for agent in run.agents_of(fleet)]
    trace.merge(merged, replace(header, started=result.started), result.zero, poses, agents, result.marks)
    poses.unlink()
    return summary.summarise(*trace.read(merged), result)


def _steered(
    run: Run, wrong: tuple[Schedule, Any], folder: Path, options: argparse.Namespace, view: Live | None
) -> tuple[ManualFaults | None, PaceLimit | None]:
    """Add the companions that inject faults and limit the pace, from the options or for the live view."""
    from targets.sim.view.web.control import Control, ManualFaults
    from targets.sim.view.web.live import PaceLimit

    schedule, told = wrong
    given, paced = None, PaceLimit(options.pace) if options.lockstep else None
    if view is not None:
        if options.follow is None:
            given = ManualFaults(faults.Faults(schedule, open=True), told, folder)
        run.companions.append(Control(view, given, paced))
        return given, paced
    if schedule != Schedule() and options.follow is None:
        run.companions.append(faults.Faults(schedule))
    if paced is not None:
        run.companions.append(paced)
    return None, paced


def _header(fleet: SimulatedFleet, plan: ReplayPlan | None, options: argparse.Namespace) -> Header:
    """Return the header of the merged trace of a fleet, assuming that round 1 begins."""
    from msgspec import UNSET

    from koordgen.runtime.trace.schema import FORMAT, Header, RobotName

    scenario = fleet.scenario
    names = tuple(RobotName(fleet.own_name(r.name), r.pid, r.target) for r in scenario.robots)
    applications = tuple(each.name for each in scenario.applications) or (scenario.app,)
    return Header(
        FORMAT, scenario.app, scenario.program_hash, scenario.delta, options.seed, names, options.duration, True,
        scenario.number("min_separation", 0.0), (scenario.geofence.lo, scenario.geofence.hi), scenario.obstacles,
        scenario.world, scenario.shared, scenario.records, plan.kind if plan else "", applications,
        composition=scenario.applications or UNSET,
    )  # fmt: skip


def _report(folder: Path) -> None:
    from targets.sim.view import commands

    commands.export(str(folder), "png", None)
    commands.report(str(folder), None)


def _reproduce(root: Path, scenario: Scenario, folder: Path, options: argparse.Namespace, given: int) -> dict[str, str]:
    """Return the values that repeat the run, by name. `given`: number of faults injected by hand."""
    command = ["python3", str(root), "--duration", f"{options.duration:g}", "--seed", str(options.seed)]
    if options.lockstep:
        command.append("--lockstep")
    if options.settings:
        command += ["--settings", str(options.settings)]
    if options.scenario:
        command += ["--scenario", str(folder / "faults.json")]
    command += [f"--{name}={value:g}" for name in CONDITIONS if (value := getattr(options, name)) is not None]
    by_hand = f"{given}, injected in the live view; to repeat them, add --scenario {shlex.quote(str(folder / GIVEN))}"
    return {
        **({"faults by hand": by_hand} if given else {}),
        "command": options.invoked_as or shlex.join([*command, "--out", str(folder)]),
        "program": f"{scenario.source}, hash {scenario.program_hash}",
        "scenario": f"{FILE}, SHA-256 {hashlib.sha256((root / FILE).read_bytes()).hexdigest()}",
        "settings": ", ".join(f"{key} {value}" for key, value in sorted(scenario.harness.items())),
        "clock": "lockstep: the same seed gives the same trace" if options.lockstep else REAL_TIME,
        "host": f"Python {platform.python_version()}, {platform.system()} {platform.machine()}",
    }
