"""`koordgen validate`: a program's port assumptions against the simulated platforms of a fleet."""

from __future__ import annotations

import json
import shlex
import sys
import tempfile
from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

from koordgen.build.pipeline import Checked, check_file, fleet_params
from koordgen.cli.base import building, console
from koordgen.cli.base.terminal import ProgressLine, coloured_verdicts
from koordgen.cli.experiment import campaign as campaigns
from koordgen.experiment.campaign import drive, store
from koordgen.experiment.campaign.crew import Unreachable
from koordgen.experiment.campaign.plan import VALIDATION, Plan, Run
from koordgen.experiment.campaign.task import Job
from koordgen.experiment.validate import picture, samples, table
from koordgen.experiment.validate.probe import BadProbe
from koordgen.experiment.validate.reach import Asked, comparisons, reachsets, written
from koordgen.experiment.validate.suggest import Suggestion, suggestions
from koordgen.experiment.validate.verdict import Bound, Case, Verdict, verdicts
from koordgen.fleet import manifest
from koordgen.lang.analyze.params import Value
from koordgen.verify.prove.report.spell import spelled
from koordgen.verify.prove.smt.solve import Limits, SolverMissing, solver_of

LIMITS = Limits(query=10.0, total=60.0)
STATUS = {"VALIDATED": console.HOLDS, "VIOLATED": console.VIOLATED, "INCONCLUSIVE": console.INCONCLUSIVE}
FLAGS = ("--lockstep", "--windows")


def validate(options: Namespace) -> int:
    """Sample, judge, look for what could be assumed, tell."""
    checked = check_file(options.program)
    if not any(module.assumptions for module in checked.program.modules):
        way = "say under `using` what is taken for granted, such as `assume position' in Rect(position, target)`"
        raise console.Failure(console.INCONCLUSIVE, f"{options.program} assumes nothing of its ports", way)
    count = options.samples or Bound(options.epsilon, options.gamma).needed
    harness = next(t for t in map(manifest.load, manifest.available()) if t.kind == "harness")
    options.harness, options.lockstep = harness.name, True
    aside = Namespace(**{**vars(options), "format": "text"})  # one document on standard output
    bundles, app = building.planned(aside, [harness.name])
    building.require_packages()
    out = Path(options.out or f"validate-{app}")
    line = ProgressLine(sys.stderr)
    try:
        kept, ended = _sampled(aside, harness, bundles[harness.name], app, count, out, line)
        found = _found(options, checked, bundles[harness.name], kept, count, ended is None, line)
        reach = _reachsets(aside, out, line) if options.reachsets and ended is None else {}
        _tell(options, found, out, ended is None, reach)
    except (store.Unusable, Unreachable) as error:
        raise console.Failure(console.SURROUNDINGS, str(error), error.help) from None
    except OSError as error:
        raise console.Failure(console.SURROUNDINGS, f"{error.filename or out}: {error.strerror}") from None
    if ended is not None:
        raise ended
    return STATUS[found.verdict]


def _found(
    options: Namespace, checked: Checked, bundle: Mapping[str, bytes], kept: store.Store, count: int, whole: bool,
    line: ProgressLine,
) -> table.Found:  # fmt: skip
    """What the samples say; `whole`: nothing ended them early. Raises OSError."""
    numbers = [k for k in sorted(kept.results) if k < count]
    finished = [sample for k in numbers if (sample := samples.read(kept.run_folder(f"{k:04d}"), k))]
    read = {sample.run for sample in finished}
    failed = [kept.results[k].why or f"run {k:04d} left no {samples.FILE}" for k in numbers if k not in read]
    judged = verdicts(finished, count - len(finished) if whole else len(failed), Bound(options.epsilon, options.gamma))
    title = f"{Path(options.program).name} on {Path(options.fleet).name}, {len(finished)} runs"
    drawn = kept.folder / "windows.png"
    instead = _suggested(options, checked, judged, finished, line) if whole else ()
    seen = whole and picture.draw(finished, title, drawn)
    return table.Found(
        options.program, options.fleet, Bound(options.epsilon, options.gamma), count, len(finished), options.seed,
        options.seconds, _start_noise(bundle), failed[0] if failed else "", _texts(checked), judged,
        finished[0].unchecked if finished else (), instead, str(drawn) if seen else "",
    )  # fmt: skip


def _sampled(
    options: Namespace,
    harness: manifest.Target,
    bundle: Mapping[str, bytes],
    app: str,
    count: int,
    out: Path,
    line: ProgressLine,
) -> tuple[store.Store, BaseException | None]:
    """The runs, those that were finished by an earlier call among them, and what ended them early. More samples of the
    same program and fleet go on with those that are there: a sample is told by its seed alone."""
    fixed = [f"--duration={options.seconds:g}", *FLAGS]
    seeds = [str(options.seed + k) for k in range(count)]
    runs = [Run(k, {"seed": seed}, {}, {}, {"seed": seed}) for k, seed in enumerate(seeds)]
    sums = campaigns._digest(bundle[campaigns.SUMS])
    plan = Plan(app, sums, "", tuple(fixed), (f"seed={options.seed}:",), 0, VALIDATION)
    show = (lambda _: None) if options.quiet else line.show

    def job(run: Run) -> Job:
        shown = _command(options, int(run.flags["seed"]), out / store.RUNS / run.name)
        flags = (*fixed, f"--seed={run.flags['seed']}", "--no-report", f"--invoked-as={shown}")
        return Job(run.number, run.varied, flags, {}, "", True)

    with tempfile.TemporaryDirectory(prefix="koordgen-") as temporary:
        made = drive.Bundles(Path(temporary), harness.name, campaigns._builder(options, harness), runs)
        again = (out / store.PLAN).exists()
        with closing(campaigns._crew(options)) as workers, store.claimed(out, plan, again) as kept:
            carry_out = partial(drive.carry_out, runs, kept, workers, made, job, show)
            return kept, campaigns._ended(carry_out, kept, count, line, "the same command")


def _command(options: Namespace, seed: int, out: Path) -> str:
    """What repeats a sample, with its report."""
    given = [f"--param={text}" for text in options.param]
    given += [f"--functions={options.functions}"] if options.functions else []
    words = ["koordgen", options.harness, options.program, f"--fleet={options.fleet}", *given]
    return shlex.join([*words, f"--duration={options.seconds:g}", "--lockstep", f"--seed={seed}", f"--out={out}"])


def _start_noise(bundle: Mapping[str, bytes]) -> float:
    return float(json.loads(bundle["scenario.json"]).get("harness", {}).get("start_noise", 0.0))


def _texts(checked: Checked) -> dict[int, str]:
    """The assumptions as the program has them, by line."""
    return {
        a.span.line: spelled(a.formula).replace(f"{m.name}.", "")
        for m in checked.program.modules
        for a in m.assumptions
    }


def _suggested(
    options: Namespace, checked: Checked, judged: Sequence[Verdict], found: Sequence[samples.Sample], line: ProgressLine
) -> list[Suggestion]:
    """For each assumption that is violated; none without a solver, which is said."""
    violated = dict.fromkeys(v.assumption.line for v in judged if v.verdict == "VIOLATED")
    if not violated:
        return []
    given: dict[str, Value] = {
        **fleet_params(options.fleet, checked, options.program),
        **building.params(options.param),
    }
    try:
        with solver_of("z3", LIMITS) as solver:
            return [
                one for at in violated for one in suggestions(checked.source, checked.program, at, given, found, solver)
            ]
    except SolverMissing as error:
        line.end()
        console.notify(f"note: {error}: what could be assumed instead was not proved")
        return []


def _reachsets(options: Namespace, out: Path, line: ProgressLine) -> dict[str, Any]:

    return made(options, out, line)


def _tell(options: Namespace, found: table.Found, out: Path, whole: bool, reach: Mapping[str, Any]) -> None:
    def commands(case: Case) -> tuple[str, str]:
        folder = out / store.RUNS / f"{case.run:04d}"
        return _command(options, case.seed, Path(f"{folder}-again")), shlex.join(["koordgen", "replay", str(folder)])

    document: dict[str, Any] = table.document(found, commands)
    text = table.as_text(found, commands)
    if reach:
        document["reachsets"] = {key: value for key, value in reach.items() if key != "text"}
        text += f"\n{reach['text']}"
    try:
        store.replace(out / "validation.json", json.dumps(document, indent=2) + "\n")
        store.replace(out / "validation.txt", text)
    except OSError:
        if whole:  # else what ended it is what there is to tell
            raise
    if options.format == "json":
        print(json.dumps(document, indent=2), flush=True)
    else:
        print(coloured_verdicts(text, sys.stdout), end="")
        print(f"all of it: {out}" + (f"; picture: {found.picture}" if found.picture else ""))


# What `koordgen validate --reachsets` adds: where each platform of the fleet can get to on its way to one offset.

FOLDER, RUNS = "reachsets", "probes"


def made(options: Namespace, out: Path, line: ProgressLine) -> dict[str, Any]:
    """Files, and how the platforms compare, as JSON has it; `text` is that for people. They are made anew with each
    call. Raises OSError, Unreachable."""
    folder = out / FOLDER
    asked = Asked(options.offset, options.epsilon, options.gamma, options.seed)
    show: Callable[[str], None] = (lambda _: None) if options.quiet else (lambda text: line.show(f"reachsets: {text}"))
    try:
        with closing(campaigns._crew(options)) as crew, campaigns._noticed_signals() as noticed:
            runs = store.cleared(folder / RUNS)
            found = reachsets(options.fleet, (), asked, crew, runs, show, lambda: bool(noticed))
        files = written(found, folder)
    except BadProbe as error:
        raise console.Failure(console.SURROUNDINGS, str(error), error.help) from None
    except drive.DiskFull:
        raise console.Failure(
            console.SURROUNDINGS, f"{folder}: the disk is full", "make room; the same command goes on"
        ) from None
    finally:
        line.end()
    tables = comparisons(found)
    told = [f"{r.platform}: {r.overshoot:+.2f} m beyond the target, {r.lateral:.2f} m to a side" for r in found]
    where = f"to ({', '.join(f'{v:g}' for v in asked.offset)}) m"
    text = "\n".join(
        [f"reachsets {where} ({folder}):", *(f"  {line}" for line in told), "", *(t.text() for t in tables)]
    )
    return {
        "offset": list(asked.offset), "files": [str(file) for file in files],
        "comparisons": [t.json() for t in tables], "text": text,
    }  # fmt: skip
