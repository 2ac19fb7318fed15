"""Command `koordgen campaign`: executes many simulation runs of one fleet, and prints statistics of their results."""

from __future__ import annotations

import hashlib
import json
import math
import os
import shlex
import signal
import subprocess
import sys
import tempfile
from argparse import Namespace
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

from koordgen.cli.base import building, console
from koordgen.cli.base.terminal import ProgressLine
from koordgen.cli.base.values import is_fleet
from koordgen.cli.experiment.harness import read_scenario
from koordgen.experiment.campaign import drive, executor, plan, store, vary
from koordgen.experiment.campaign.task import Job
from koordgen.fleet import manifest
from koordgen.fleet.manifest import Target

SUMS = "SHA256SUMS"
SCENARIO = "scenario"
STATUS = {"held": console.HOLDS, "violated": console.VIOLATED, "failed": console.SURROUNDINGS}
OWN = {"out", "live", "settings", "invoked-as"}  # options of a run that the user cannot vary in a campaign


def campaign(options: Namespace) -> int:
    """Plan a campaign, lock its folder, execute its runs, and print the table of results.

    Return the exit status of the command. Raises Failure."""
    harness = next(t for t in map(manifest.load, manifest.available()) if t.kind == "harness")
    try:
        varied = vary.parse(options.vary)
        count = options.runs or vary.natural(varied)
        if count is None:
            raise vary.BadVary("the number of runs is missing; use --runs N")
        runs = plan.runs(varied, count, harness.settings)
        _check_variation(runs, harness)
    except vary.BadVary as error:
        way = "give --vary items like seed, seed=1:70, NAME=LO:HI or NAME=A,B,C, separated by commas"
        raise console.Failure(console.USAGE, str(error), way) from None
    building.fleet_path(options)
    _check_params(options, runs)
    if options.verdict and not Path(options.verdict).is_file():
        raise console.Failure(console.WRONG, f"--verdict {options.verdict}: no such file; give the path of a script")
    options.collected = []
    bundles, app = building.planned(options, [harness.name], squads=True)
    building.require_packages()
    fixed = _fixed(options)
    scenarios = _scenarios(runs, bundles[harness.name])
    sums = bundles[harness.name][SUMS] + "".join(scenarios.values()).encode()
    verdict = _digest(Path(options.verdict).read_bytes()) if options.verdict else ""
    wanted = plan.CampaignPlan(app, _digest(sums), verdict, tuple(fixed), tuple(options.vary), count)
    out = Path(options.out or f"campaign-{app}")
    line = ProgressLine(sys.stderr)
    show = (lambda _: None) if options.quiet else line.show
    with tempfile.TemporaryDirectory(prefix="koordgen-") as temporary:
        made = drive.Bundles(Path(temporary), harness.name, _builder(options, harness), runs)
        _check_accepted(made.of(runs[0]), _representative_runs(runs, vary.cells(varied)), fixed, harness)
        try:
            with closing(_executor(options)) as workers, store.claimed(out, wanted, options.resume) as kept:
                job = _jobs(options, out, fixed, harness, scenarios)
                carry_out = partial(drive.execute_runs, runs, kept, workers, made, job, show)
                ended = _ended(carry_out, kept, count, line)
                _show_table(options, kept, app, count, vary.cells(varied), ended is None)
        except (store.FolderUnusable, executor.ClusterUnreachable) as error:
            raise console.Failure(console.SURROUNDINGS, str(error), error.help) from None
        except OSError as error:
            raise console.Failure(console.SURROUNDINGS, f"{error.filename or out}: {error.strerror}") from None
    if isinstance(ended, BaseException):
        raise ended
    return STATUS[_verdict(kept)]


def _verdict(kept: store.CampaignStore) -> str:
    """Return the worst outcome of all runs: `violated`, else `failed` (a run could not be executed), else `held`."""
    outcomes = {result.outcome for result in kept.results.values()}
    return "violated" if "violated" in outcomes else "failed" if "failed" in outcomes else "held"


def _show_table(
    options: Namespace,
    kept: store.CampaignStore,
    app: str,
    planned: int,
    cells: Sequence[Mapping[str, str]],
    whole: bool,
) -> None:
    try:
        text = drive.write_table(kept, app, planned, cells)
        if options.format == "json":
            found = json.loads((kept.folder / "campaign.json").read_bytes())
            verdict = _verdict(kept) if whole else "interrupted"
            console.print_document(options, {"verdict": verdict, "folder": str(kept.folder), **found})
            return
        print(text, end="", file=console.output(options))
        print(f"table and plots are in {kept.folder}", file=console.output(options))
    except OSError:
        # If the campaign ended early, the caller reports the reason, which matters more than this error.
        if whole:
            raise


def _executor(options: Namespace) -> executor.Executor:
    if options.cluster:
        return executor.DaskCluster(options.cluster)
    # By default, only one run in real time is executed at a time, because such runs would slow each other down.
    return executor.LocalPool(options.jobs or ((os.cpu_count() or 1) if options.lockstep else 1))


def _fixed(options: Namespace) -> list[str]:
    """Return the command-line options that the bundle gets in all runs of a campaign."""
    found = [] if options.duration is None else [f"--duration={options.duration:g}"]
    return [*found, "--lockstep"] if options.lockstep else found


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _builder(options: Namespace, harness: Target) -> drive.Build:
    """Return a function that builds a simulation bundle with given params.

    The function prints no diagnostics, because they were printed when the campaign was planned."""

    def build(params: Mapping[str, str], folder: Path) -> None:
        from koordgen.build.pipeline import plan_file, plan_fleet_file
        from koordgen.lang.analyze.params import BadParam

        if is_fleet(options.program):
            _, bundles = plan_fleet_file(options.program, [harness.name])
            building.write({harness.name: bundles[harness.name]}, folder)
            return
        given = building.params([*options.param, *(f"{name}={value}" for name, value in params.items())])
        try:
            files = options.fleet, given, options.functions
            _, bundles = plan_file(options.program, [harness.name], *files, squads=True)
        except BadParam as error:
            raise console.Failure(console.USAGE, str(error)) from None
        building.write({harness.name: bundles[harness.name]}, folder)

    return build


def _check_params(options: Namespace, runs: Sequence[plan.PlannedRun]) -> None:
    """Raise Failure if params are varied, but the fleet file gives the params of several programs."""
    if runs[0].params and is_fleet(options.program):
        name = next(iter(runs[0].params))
        message = f"{vary.PARAM}{name} cannot be varied: {options.program} has the params of its applications"
        help = "write one fleet file for each value, and run a campaign of each"
        raise console.Failure(console.USAGE, message, help)


def _check_variation(runs: Sequence[plan.PlannedRun], harness: Target) -> None:
    """Check that the user may vary all varied names, and that the manifest allows all values of varied settings.

    Raises BadVary if not."""
    for name in OWN.intersection(runs[0].flags):
        raise vary.BadVary(f"{name} cannot be varied in a campaign")
    for name, value in dict.fromkeys(item for run in runs for item in _settings(run, harness).items()):
        if why := harness.settings[name].misfit(value):
            raise vary.BadVary(f"{name}={value}: {why}")


def _settings(run: plan.PlannedRun, harness: Target) -> dict[str, Any]:
    """Return the varied settings of the simulation harness for one run, as name -> value.

    The text of a value becomes a number or a bool, unless the setting has the type string."""
    found: dict[str, Any] = dict(run.settings)
    for name, text in run.settings.items():
        if harness.settings[name].type != "string":
            with suppress(ValueError):
                value = json.loads(text)
                found[name] = value if isinstance(value, (int, float)) else text
    return found


def _scenarios(runs: Sequence[plan.PlannedRun], bundle: Mapping[str, bytes]) -> dict[str, str]:
    """Read the scenario files that are varied, and return their contents as path -> JSON text.

    A campaign sends the contents to its workers, which cannot read these files. Raises Rejected, with line and
    column."""
    paths = dict.fromkeys(run.flags[SCENARIO] for run in runs if SCENARIO in run.flags)
    return {path: json.dumps(read_scenario(path, bundle, math.inf)) for path in paths}


def _representative_runs(runs: Sequence[plan.PlannedRun], cells: Sequence[Mapping[str, str]]) -> list[plan.PlannedRun]:
    """Return the runs to check before a campaign: for each value of a varied list its first run, and the last run."""
    seen: set[tuple[str, str]] = set()
    found = []
    for run in runs[: len(cells)]:
        new = {item for item in run.flags.items() if item[0] in cells[0] and item[0] != vary.SEED} - seen
        if new or not run.number:
            found.append(run)
            seen |= new
    return found if runs[-1] in found else [*found, runs[-1]]


def _check_accepted(bundle: Path, runs: Sequence[plan.PlannedRun], fixed: Sequence[str], harness: Target) -> None:
    """Check that the bundle accepts the command-line options of the given runs, without executing the runs.

    Raises Failure with the bundle's error message."""
    for run in runs:
        flags = [*fixed, *_flags(run)]
        command = [sys.executable, str(bundle), "--check", *flags]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode == console.USAGE:
            said = [line for line in done.stderr.splitlines() if "error:" in line]
            why = said[-1].partition("error:")[2].strip() if said else done.stderr.strip()
            known = ", ".join(sorted(harness.settings))
            way = f"vary seed, param.NAME, an option of `koordgen {harness.name}`, or one of its settings: {known}"
            raise console.Failure(console.USAGE, f"run {run.name} ({shlex.join(flags)}): {why}", way)
        if done.returncode:
            lines = done.stderr.strip().splitlines() or [f"run {run.name}: the bundle failed without a message"]
            more = [line.strip().removeprefix("help: ") for line in lines[1:]]
            raise console.Failure(done.returncode, lines[0].removeprefix("error: "), "; ".join(more))


def _flags(run: plan.PlannedRun) -> list[str]:
    return [f"--{name}={value}" for name, value in run.flags.items()]


def _jobs(
    options: Namespace, out: Path, fixed: Sequence[str], harness: Target, scenarios: Mapping[str, str]
) -> Callable[[plan.PlannedRun], Job]:
    """Return a function that converts a planned run into a job for an executor."""
    script = str(Path(options.verdict).resolve()) if options.verdict else ""

    def job(run: plan.PlannedRun) -> Job:
        shown = shlex.join(_single(options, run, fixed, harness, out / store.RUNS / run.name))
        spared = () if options.reports else ("--no-report",)
        own = [flag for flag in _flags(run) if not flag.startswith(f"--{SCENARIO}=")]
        scenario = scenarios.get(run.flags.get(SCENARIO, ""), "")
        flags = (*fixed, *own, *spared, f"--invoked-as={shown}")
        return Job(run.number, run.varied, flags, _settings(run, harness), script, options.lockstep, scenario)

    return job


def _ended(
    carry_out: Callable[[Callable[[], bool]], None],
    kept: store.CampaignStore,
    planned: int,
    line: ProgressLine,
    again: str = "--resume",
) -> BaseException | None:
    """Execute the runs of a campaign with the function `carry_out`.

    Return None if all runs were executed, or else the exception that ended the campaign early. After an early end, a
    message says that `again` (an option or a command) executes the remaining runs."""
    resumable = ("{} of {} runs are finished; " + f"{again} executes the others").format
    try:
        with _recorded_signals() as received:
            carry_out(lambda: bool(received))
    except KeyboardInterrupt as interrupt:
        line.end()
        print(resumable(len(kept.results), planned), file=sys.stderr)
        return interrupt
    except drive.DiskFull:
        line.end()
        said = f"the disk is full; {resumable(len(kept.results), planned)}"
        return console.Failure(console.SURROUNDINGS, f"{kept.folder}: {said}", "free disk space")
    except executor.ClusterUnreachable as lost:
        line.end()
        return console.Failure(console.SURROUNDINGS, f"{lost}; {resumable(len(kept.results), planned)}", lost.help)
    line.end()
    return None


def _single(options: Namespace, run: plan.PlannedRun, fixed: Sequence[str], harness: Target, folder: Path) -> list[str]:
    """Return the command line that repeats one run of a campaign. The report of the run shows the command line."""
    params = [f"--param={name}={value}" for name, value in run.params.items()]
    settings = [f"# {name}: {value}" for name, value in run.settings.items()]
    words = ["koordgen", harness.name, *building.invocation(options), *params, *fixed, *_flags(run)]
    return [*words, f"--out={folder}", *settings]


@contextmanager
def _recorded_signals() -> Iterator[list[int]]:
    """Record SIGINT, SIGTERM and SIGHUP instead of ending the process, so that the caller can end in an orderly way.

    Yields the list of received signal numbers. A signal that the process ignores stays ignored."""
    received: list[int] = []
    watched = [s for s in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP) if signal.getsignal(s) != signal.SIG_IGN]
    before = {each: signal.signal(each, lambda number, _: received.append(number)) for each in watched}
    try:
        yield received
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
