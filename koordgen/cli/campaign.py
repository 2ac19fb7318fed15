"""`koordgen campaign`: many runs of one fleet."""

from __future__ import annotations

import hashlib
import os
import shlex
import signal
import subprocess
import sys
import tempfile
from argparse import Namespace
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path

from koordgen import cli, manifest
from koordgen.campaign import crew, drive, plan, store, vary
from koordgen.campaign.task import Job, typed
from koordgen.cli.terminal import Line
from koordgen.manifest import Target

SUMS = "SHA256SUMS"


def campaign(options: Namespace) -> int:
    """Plan it, claim its folder, carry it out, show the table."""
    harness = next(t for t in map(manifest.load, manifest.available()) if t.kind == "harness")
    try:
        varied = vary.parse(options.vary)
        count = options.runs or vary.natural(varied)
        if count is None:
            raise vary.BadVary("say how many runs with --runs N")
        runs = plan.runs(varied, count, harness.settings)
    except vary.BadVary as error:
        way = "--vary takes seed, seed=1:70, NAME=LO:HI and NAME=A,B,C, with commas between them"
        raise cli.Failure(cli.USAGE, str(error), way) from None
    if options.verdict and not Path(options.verdict).is_file():
        raise cli.Failure(cli.USAGE, f"--verdict {options.verdict}: no such file")
    bundles, app = cli._planned(options, [harness.name])
    cli._require_packages()
    fixed = _fixed(options)
    sums = bundles[harness.name][SUMS]
    verdict = _digest(Path(options.verdict).read_bytes()) if options.verdict else ""
    wanted = plan.Plan(app, _digest(sums), verdict, tuple(fixed), tuple(options.vary), count)
    out = Path(options.out or f"campaign-{app}")
    line = Line(sys.stderr)
    show = (lambda _: None) if options.quiet else line.show
    with tempfile.TemporaryDirectory(prefix="koordgen-") as temporary:
        made = drive.Bundles(Path(temporary), harness.name, _builder(options, harness), runs)
        _accepted(made.of(runs[0]), runs, fixed, harness)
        try:
            with closing(_crew(options)) as workers, store.claimed(out, wanted, options.resume) as kept:
                job = _jobs(options, out, fixed, harness)
                carry_out = partial(drive.carry_out, runs, kept, workers, made, job, show)
                ended = _ended(carry_out, kept, count, line)
                _show_table(kept, app, count, vary.cells(varied), ended is None)
        except (store.Unusable, crew.Unreachable) as error:
            raise cli.Failure(cli.SURROUNDINGS, str(error), error.help) from None
        except OSError as error:
            raise cli.Failure(cli.SURROUNDINGS, f"{error.filename or out}: {error.strerror}") from None
    if isinstance(ended, BaseException):
        raise ended
    outcomes = {result.outcome for result in kept.results.values()}
    return cli.VIOLATED if "violated" in outcomes else cli.SURROUNDINGS if "failed" in outcomes else cli.HOLDS


def _show_table(kept: store.Store, app: str, planned: int, cells: Sequence[Mapping[str, str]], whole: bool) -> None:
    try:
        print(drive.write_table(kept, app, planned, cells), end="")
        print(f"table and pictures: {kept.folder}")
    except OSError:
        if whole:  # else what ended the campaign is what there is to tell
            raise


def _crew(options: Namespace) -> crew.Crew:
    if options.cluster:
        return crew.Cluster(options.cluster)
    # In real time two runs disturb one another.
    return crew.Local(options.jobs or ((os.cpu_count() or 1) if options.lockstep else 1))


def _fixed(options: Namespace) -> list[str]:
    """The bundle's options that all runs have."""
    found = [] if options.duration is None else [f"--duration={options.duration:g}"]
    return [*found, "--lockstep"] if options.lockstep else found


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _builder(options: Namespace, harness: Target) -> drive.Build:
    """Builds without a word: what there is to say of the program was said before."""

    def build(params: Mapping[str, str], folder: Path) -> None:
        from koordgen.check.params import BadParam
        from koordgen.pipeline import plan_file

        given = cli._params([*options.param, *(f"{name}={value}" for name, value in params.items())])
        try:
            _, bundles = plan_file(options.program, [harness.name], options.fleet, given, options.functions)
        except BadParam as error:
            raise cli.Failure(cli.USAGE, str(error)) from None
        cli._write({harness.name: bundles[harness.name]}, folder)

    return build


def _accepted(bundle: Path, runs: Sequence[plan.Run], fixed: Sequence[str], harness: Target) -> None:
    """Whether the bundle takes what is varied: it looks at its options and runs nothing. The first run and the last."""
    for run in dict.fromkeys((0, len(runs) - 1)):
        flags = [*fixed, *_flags(runs[run])]
        command = [sys.executable, str(bundle), "--check", *flags]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode == cli.USAGE:
            said = [line for line in done.stderr.splitlines() if "error:" in line]
            why = said[-1].partition("error:")[2].strip() if said else done.stderr.strip()
            known = ", ".join(sorted(harness.settings))
            way = f"--vary takes seed, param.NAME, options of `koordgen {harness.name}`, and its settings: {known}"
            raise cli.Failure(cli.USAGE, f"run {run:04d} ({shlex.join(flags)}): {why}", way)
        if done.returncode:
            lines = done.stderr.strip().splitlines() or ["it said nothing"]
            raise cli.Failure(done.returncode, lines[0].removeprefix("error: "), "; ".join(lines[1:]).strip())


def _flags(run: plan.Run) -> list[str]:
    return [f"--{name}={value}" for name, value in run.flags.items()]


def _jobs(options: Namespace, out: Path, fixed: Sequence[str], harness: Target) -> Callable[[plan.Run], Job]:
    """What is to be run for a run."""
    script = str(Path(options.verdict).resolve()) if options.verdict else ""

    def job(run: plan.Run) -> Job:
        shown = shlex.join(_single(options, run, fixed, harness, out / store.RUNS / run.name))
        spared = () if options.reports else ("--no-report",)
        flags = (*fixed, *_flags(run), *spared, f"--invoked-as={shown}")
        return Job(run.number, run.varied, flags, run.settings, script, gentle=options.lockstep)

    return job


def _ended(
    carry_out: Callable[[Callable[[], bool]], None], kept: store.Store, planned: int, line: Line
) -> BaseException | None:
    """Why it ended before its end, or None. What was finished is there either way."""
    resumable = "{} of {} runs are finished; --resume goes on from there".format
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
        return cli.Failure(cli.SURROUNDINGS, f"{kept.folder}: {said}", "make room and call it again with --resume")
    except crew.Unreachable as lost:
        line.end()
        return cli.Failure(cli.SURROUNDINGS, f"{lost}; {resumable(len(kept.results), planned)}", lost.help)
    line.end()
    return None


def _single(options: Namespace, run: plan.Run, fixed: Sequence[str], harness: Target, folder: Path) -> list[str]:
    """The command that repeats one run, for its report."""
    params = [f"--param={text}" for text in [*options.param, *(f"{n}={v}" for n, v in run.params.items())]]
    settings = [f"# {name}: {typed(value)}" for name, value in run.settings.items()]
    words = ["koordgen", harness.name, options.program, f"--fleet={options.fleet}", *params, *fixed, *_flags(run)]
    return [*words, f"--out={folder}", *settings]


@contextmanager
def _noticed_signals() -> Iterator[list[int]]:
    """SIGINT, SIGTERM and SIGHUP end a campaign where it can be resumed, and not in the middle of a line."""
    noticed: list[int] = []
    watched = [s for s in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP) if signal.getsignal(s) != signal.SIG_IGN]
    before = {each: signal.signal(each, lambda number, _: noticed.append(number)) for each in watched}
    try:
        yield noticed
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
