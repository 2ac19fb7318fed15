"""`koordgen campaign`: many runs of one fleet."""

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
from koordgen.cli.experiment.harness import read_scenario
from koordgen.experiment.campaign import drive, executor, plan, store, vary
from koordgen.experiment.campaign.task import Job
from koordgen.fleet import manifest
from koordgen.fleet.manifest import Target

SUMS = "SHA256SUMS"
SCENARIO = "scenario"
STATUS = {"held": console.HOLDS, "violated": console.VIOLATED, "failed": console.SURROUNDINGS}
OWN = {
    "out",
    "live",
    "settings",
    "invoked-as",
}  # options of a run that a campaign sets itself or cannot use


def campaign(options: Namespace) -> int:
    """Plan the campaign, claim its folder, execute the runs, print the table."""
    harness = next(t for t in map(manifest.load, manifest.available()) if t.kind == "harness")
    try:
        varied = vary.parse(options.vary)
        count = options.runs or vary.natural(varied)
        if count is None:
            raise vary.BadVary("say how many runs with --runs N")
        runs = plan.runs(varied, count, harness.settings)
        _check_variation(runs, harness)
    except vary.BadVary as error:
        way = "--vary takes seed, seed=1:70, NAME=LO:HI and NAME=A,B,C, with commas between them"
        raise console.Failure(console.USAGE, str(error), way) from None
    if options.verdict and not Path(options.verdict).is_file():
        raise console.Failure(console.WRONG, f"--verdict {options.verdict}: no such file")
    options.collected = []
    bundles, app = building.planned(options, [harness.name])
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
    """Return the worst outcome of all runs: `held`, `failed` (a run could not be made) or `violated`."""
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
        print(f"table and pictures: {kept.folder}", file=console.output(options))
    except OSError:
        if whole:  # otherwise the reason why the campaign ended is reported
            raise


def _executor(options: Namespace) -> executor.Executor:
    if options.cluster:
        return executor.DaskCluster(options.cluster)
    # Runs in real time would disturb one another.
    return executor.LocalPool(options.jobs or ((os.cpu_count() or 1) if options.lockstep else 1))


def _fixed(options: Namespace) -> list[str]:
    """Return the options that all runs pass to the bundle."""
    found = [] if options.duration is None else [f"--duration={options.duration:g}"]
    return [*found, "--lockstep"] if options.lockstep else found


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _builder(options: Namespace, harness: Target) -> drive.Build:
    """Return a function that builds bundles silently. Diagnostics were already reported."""

    def build(params: Mapping[str, str], folder: Path) -> None:
        from koordgen.build.pipeline import plan_file
        from koordgen.lang.analyze.params import BadParam

        given = building.params([*options.param, *(f"{name}={value}" for name, value in params.items())])
        try:
            _, bundles = plan_file(options.program, [harness.name], options.fleet, given, options.functions)
        except BadParam as error:
            raise console.Failure(console.USAGE, str(error)) from None
        building.write({harness.name: bundles[harness.name]}, folder)

    return build


def _check_variation(runs: Sequence[plan.PlannedRun], harness: Target) -> None:
    """Check that the named things may vary, and that the manifest allows the values of settings.

    Raises BadVary."""
    for name in OWN.intersection(runs[0].flags):
        raise vary.BadVary(f"{name}: each run has its own")
    for name, value in dict.fromkeys(item for run in runs for item in _settings(run, harness).items()):
        if why := harness.settings[name].misfit(value):
            raise vary.BadVary(f"{name}={value}: {why}")


def _settings(run: plan.PlannedRun, harness: Target) -> dict[str, Any]:
    """Return the harness' settings of a run.

    A value becomes a number or bool unless the setting is a text."""
    found: dict[str, Any] = dict(run.settings)
    for name, text in run.settings.items():
        if harness.settings[name].type != "string":
            with suppress(ValueError):
                value = json.loads(text)
                found[name] = value if isinstance(value, (int, float)) else text
    return found


def _scenarios(runs: Sequence[plan.PlannedRun], bundle: Mapping[str, bytes]) -> dict[str, str]:
    """Return the contents of the varied scenario files as JSON, by path, since workers lack these files.

    Raises Rejected, with line and column."""
    paths = dict.fromkeys(run.flags[SCENARIO] for run in runs if SCENARIO in run.flags)
    return {path: json.dumps(read_scenario(path, bundle, math.inf)) for path in paths}


def _representative_runs(runs: Sequence[plan.PlannedRun], cells: Sequence[Mapping[str, str]]) -> list[plan.PlannedRun]:
    """Return the runs in which a value of a varied list occurs for the first time, and the last run."""
    seen: set[tuple[str, str]] = set()
    found = []
    for run in runs[: len(cells)]:
        new = {item for item in run.flags.items() if item[0] in cells[0] and item[0] != vary.SEED} - seen
        if new or not run.number:
            found.append(run)
            seen |= new
    return found if runs[-1] in found else [*found, runs[-1]]


def _check_accepted(bundle: Path, runs: Sequence[plan.PlannedRun], fixed: Sequence[str], harness: Target) -> None:
    """Check that the bundle accepts the options of these runs. Nothing is run. Raises Failure."""
    for run in runs:
        flags = [*fixed, *_flags(run)]
        command = [sys.executable, str(bundle), "--check", *flags]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode == console.USAGE:
            said = [line for line in done.stderr.splitlines() if "error:" in line]
            why = said[-1].partition("error:")[2].strip() if said else done.stderr.strip()
            known = ", ".join(sorted(harness.settings))
            way = f"--vary takes seed, param.NAME, options of `koordgen {harness.name}`, and its settings: {known}"
            raise console.Failure(console.USAGE, f"run {run.name} ({shlex.join(flags)}): {why}", way)
        if done.returncode:
            lines = done.stderr.strip().splitlines() or ["it said nothing"]
            more = [line.strip().removeprefix("help: ") for line in lines[1:]]
            raise console.Failure(done.returncode, lines[0].removeprefix("error: "), "; ".join(more))


def _flags(run: plan.PlannedRun) -> list[str]:
    return [f"--{name}={value}" for name, value in run.flags.items()]


def _jobs(
    options: Namespace, out: Path, fixed: Sequence[str], harness: Target, scenarios: Mapping[str, str]
) -> Callable[[plan.PlannedRun], Job]:
    """Return a function that makes the job of a run."""
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
    """Execute the runs.

    Return why they ended early, or None. Finished runs are stored; `again` continues with them."""
    resumable = ("{} of {} runs are finished; " + f"{again} goes on from there").format
    try:
        with _noticed_signals() as noticed:
            carry_out(lambda: bool(noticed))
    except KeyboardInterrupt as interrupt:
        line.end()
        print(resumable(len(kept.results), planned), file=sys.stderr)
        return interrupt
    except drive.DiskFull:
        line.end()
        said = f"the disk is full; {resumable(len(kept.results), planned)}"
        return console.Failure(console.SURROUNDINGS, f"{kept.folder}: {said}", "make room")
    except executor.ClusterUnreachable as lost:
        line.end()
        return console.Failure(console.SURROUNDINGS, f"{lost}; {resumable(len(kept.results), planned)}", lost.help)
    line.end()
    return None


def _single(options: Namespace, run: plan.PlannedRun, fixed: Sequence[str], harness: Target, folder: Path) -> list[str]:
    """Return the command that repeats one run, for its report."""
    params = [f"--param={text}" for text in [*options.param, *(f"{n}={v}" for n, v in run.params.items())]]
    settings = [f"# {name}: {value}" for name, value in run.settings.items()]
    words = ["koordgen", harness.name, options.program, f"--fleet={options.fleet}", *params, *fixed, *_flags(run)]
    return [*words, f"--out={folder}", *settings]


@contextmanager
def _noticed_signals() -> Iterator[list[int]]:
    """Record SIGINT, SIGTERM and SIGHUP, so that the campaign ends where it can be resumed."""
    noticed: list[int] = []
    watched = [s for s in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP) if signal.getsignal(s) != signal.SIG_IGN]
    before = {each: signal.signal(each, lambda number, _: noticed.append(number)) for each in watched}
    try:
        yield noticed
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
