"""Command `koordgen validate`: checks a program's assumptions about its ports in simulation runs of a fleet."""

from __future__ import annotations

import json
import shlex
import sys
import tempfile
from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from koordgen.build.pipeline import Checked, check_file, check_system, fleet_params
from koordgen.cli.base import building, console
from koordgen.cli.base.terminal import ProgressLine, coloured_verdicts
from koordgen.cli.base.values import is_fleet
from koordgen.cli.experiment import campaign as campaigns
from koordgen.experiment.campaign import drive, store
from koordgen.experiment.campaign.executor import ClusterUnreachable
from koordgen.experiment.campaign.plan import VALIDATION, CampaignPlan, PlannedRun
from koordgen.experiment.campaign.task import Job
from koordgen.experiment.validate import picture, samples, table
from koordgen.experiment.validate.probe import BadProbe
from koordgen.experiment.validate.reach import ReachsetRequest, comparisons, reachsets, write_files
from koordgen.experiment.validate.suggest import Suggestion, suggestions
from koordgen.experiment.validate.verdict import AssumptionVerdict, Case, ProbabilityBound, verdicts
from koordgen.fleet import manifest
from koordgen.lang.analyze.params import Value
from koordgen.verify.prove.report.koord_text import to_koord
from koordgen.verify.prove.smt.solve import Limits, SolverMissing, solver_of

LIMITS = Limits(query=10.0, total=60.0)
STATUS = {"VALIDATED": console.HOLDS, "VIOLATED": console.VIOLATED, "INCONCLUSIVE": console.INCONCLUSIVE}


@dataclass(frozen=True)
class ValidatedProgram:
    """Program whose assumptions are validated.

    `fleet`: path of the fleet file. `application`: its name, if the fleet has several; else "". `given`: the values of
    params in the `applications` of the fleet file, if the file names the program."""

    checked: Checked
    fleet: str
    application: str = ""
    given: Mapping[str, Value] | None = None

    @property
    def path(self) -> str:
        """Path of the program."""
        return self.checked.source.path

    @property
    def flags(self) -> tuple[str, ...]:
        """Command-line options of all simulation runs."""
        return ("--lockstep", f"--windows={self.application}" if self.application else "--windows")


def validate(options: Namespace) -> int:
    """Execute simulation runs, judge the program's assumptions, suggest weaker assumptions, and print a report.

    Return the exit status of the command. Raises Failure, Rejected."""
    of = _validated(options)
    count = options.samples or ProbabilityBound(options.epsilon, options.gamma).needed
    harness = next(t for t in map(manifest.load, manifest.available()) if t.kind == "harness")
    options.harness, options.lockstep = harness.name, True
    aside = Namespace(**{**vars(options), "format": "text"})  # only the report may be printed as JSON
    bundles, app = building.planned(aside, [harness.name], squads=not options.reachsets)
    building.require_packages()
    out = Path(options.out or "-".join(filter(None, ["validate", app, of.application])))
    line = ProgressLine(sys.stderr)
    try:
        kept, ended = _sampled(aside, of, harness, bundles[harness.name], app, count, out, line)
        found = _report(options, of, bundles[harness.name], kept, count, ended is None, line)
        reach = _reachsets(aside, of.fleet, out, line) if options.reachsets and ended is None else {}
        _print_report(options, found, out, ended is None, reach)
    except (store.FolderUnusable, ClusterUnreachable) as error:
        raise console.Failure(console.SURROUNDINGS, str(error), error.help) from None
    except OSError as error:
        raise console.Failure(console.SURROUNDINGS, f"{error.filename or out}: {error.strerror}") from None
    if ended is not None:
        raise ended
    return STATUS[found.verdict]


def _validated(options: Namespace) -> ValidatedProgram:
    """Return the program whose assumptions are to be validated. Raises Failure, Rejected."""
    fleet = building.fleet_path(options)
    way = "write assumptions under `using`, such as `assume position' in Rect(position, target)`"
    nothing = console.Failure(console.INCONCLUSIVE, f"{options.program} has no assumptions about its ports", way)
    if not is_fleet(options.program):
        if options.application is not None:
            help = "name the application's program, or give its fleet file in place of the program"
            raise console.Failure(console.USAGE, "--application needs a fleet file with `applications`", help)
        checked = check_file(options.program)
        if not _has_assumptions(checked):
            raise nothing
        return ValidatedProgram(checked, fleet)
    system = check_system(fleet)
    pairs = zip(system.fleet.applications, system.parts, strict=True)
    found = {settings.name: (settings, part) for settings, part in pairs if _has_assumptions(part)}
    if not found:
        raise nothing
    wanted = options.application or next(iter(found))
    if wanted not in found or (options.application is None and len(found) > 1):
        wrong = f"no application {wanted} with assumptions" if wanted not in found else "several have assumptions"
        help = f"choose one of {', '.join(found)} with --application"
        raise console.Failure(console.USAGE, f"{options.program}: {wrong}", help)
    settings, part = found[wanted]
    return ValidatedProgram(part, fleet, wanted if len(system.parts) > 1 else "", settings.params)


def _has_assumptions(checked: Checked) -> bool:
    return any(module.assumptions for module in checked.program.modules)


def _report(
    options: Namespace, of: ValidatedProgram, bundle: Mapping[str, bytes], kept: store.CampaignStore, count: int,
    whole: bool, line: ProgressLine,
) -> table.ValidationReport:  # fmt: skip
    """Judge the assumptions from the finished runs, and return the report.

    `count`: number of wanted runs. `whole`: true if the runs did not end early. Raises OSError."""
    numbers = [k for k in sorted(kept.results) if k < count]
    finished = [sample for k in numbers if (sample := samples.read(kept.run_folder(f"{k:04d}"), k))]
    read = {sample.run for sample in finished}
    failed = [kept.results[k].why or f"run {k:04d} left no {samples.FILE}" for k in numbers if k not in read]
    judged = verdicts(
        finished, count - len(finished) if whole else len(failed), ProbabilityBound(options.epsilon, options.gamma)
    )
    title = f"{Path(of.path).name} on {Path(of.fleet).name}, {len(finished)} runs"
    drawn = kept.folder / "windows.png"
    instead = _suggested(options, of, judged, finished, line) if whole else ()
    seen = whole and picture.draw(finished, title, drawn)
    return table.ValidationReport(
        of.path, of.fleet, ProbabilityBound(options.epsilon, options.gamma), count, len(finished),
        options.seed, options.seconds, _start_noise(bundle), failed[0] if failed else "", _texts(of.checked), judged,
        finished[0].unchecked if finished else (), instead, str(drawn) if seen else "",
        _hashes(bundle),
    )  # fmt: skip


def _sampled(
    options: Namespace,
    of: ValidatedProgram,
    harness: manifest.Target,
    bundle: Mapping[str, bytes],
    app: str,
    count: int,
    out: Path,
    line: ProgressLine,
) -> tuple[store.CampaignStore, BaseException | None]:
    """Execute the simulation runs that are not in the folder `out` yet.

    The folder may contain runs of an earlier command for the same program and fleet, because a run depends only on its
    seed. Return all stored runs, and None or the exception that ended the execution early."""
    fixed = [f"--duration={options.seconds:g}", *of.flags]
    seeds = [str(options.seed + k) for k in range(count)]
    runs = [PlannedRun(k, {"seed": seed}, {}, {}, {"seed": seed}) for k, seed in enumerate(seeds)]
    sums = campaigns._digest(bundle[campaigns.SUMS])
    plan = CampaignPlan(app, sums, "", tuple(fixed), (f"seed={options.seed}:",), 0, VALIDATION)
    show = (lambda _: None) if options.quiet else line.show

    def job(run: PlannedRun) -> Job:
        shown = _command(options, int(run.flags["seed"]), out / store.RUNS / run.name)
        flags = (*fixed, f"--seed={run.flags['seed']}", "--no-report", f"--invoked-as={shown}")
        return Job(run.number, run.varied, flags, {}, "", True)

    with tempfile.TemporaryDirectory(prefix="koordgen-") as temporary:
        bundles = drive.Bundles(Path(temporary), harness.name, campaigns._builder(options, harness), runs)
        again = (out / store.PLAN).exists()
        with closing(campaigns._executor(options)) as workers, store.claimed(out, plan, again) as kept:
            carry_out = partial(drive.execute_runs, runs, kept, workers, bundles, job, show)
            return kept, campaigns._ended(carry_out, kept, count, line, "the same command")


def _command(options: Namespace, seed: int, out: Path) -> str:
    """Return the command line that repeats a simulation run of a validation and writes a report of the run."""
    words = ["koordgen", options.harness, *building.invocation(options)]
    return shlex.join([*words, f"--duration={options.seconds:g}", "--lockstep", f"--seed={seed}", f"--out={out}"])


def _start_noise(bundle: Mapping[str, bytes]) -> float:
    return float(_scenario(bundle).get("harness", {}).get("start_noise", 0.0))


def _hashes(bundle: Mapping[str, bytes]) -> dict[str, str]:
    """Return the hash of the program under the name "", and that of each squad's programs under the squad's name."""
    scenario = _scenario(bundle)
    return {"": scenario.get("program_hash", "")} | {
        each["name"]: each["program_hash"] for each in scenario.get("fleets", ())
    }


def _scenario(bundle: Mapping[str, bytes]) -> dict[str, Any]:
    scenario: dict[str, Any] = json.loads(bundle["scenario.json"])
    return scenario


def _texts(checked: Checked) -> dict[int, str]:
    """Return the assumptions of a program, as line number -> text of the assumption in Koord."""
    return {
        a.span.line: to_koord(a.formula).replace(f"{m.name}.", "")
        for m in checked.program.modules
        for a in m.assumptions
    }


def _suggested(
    options: Namespace,
    of: ValidatedProgram,
    judged: Sequence[AssumptionVerdict],
    found: Sequence[samples.RunSample],
    line: ProgressLine,
) -> list[Suggestion]:
    """Return suggested replacements for each violated assumption.

    If the solver is missing, a note is printed and the list is empty."""
    violated = dict.fromkeys(v.assumption.line for v in judged if v.verdict == "VIOLATED")
    if not violated:
        return []
    checked = of.checked
    if checked.program.imports or checked.program.exports:
        way = f"write a weaker assumption into {of.path}, and run `koordgen prove {of.fleet}`"
        console.notify(
            f"note: no weaker assumptions are suggested, because {of.application} is not proved alone; {way}"
        )
        return []
    given: dict[str, Value] = {
        **(fleet_params(of.fleet, checked, of.path, squads=True) if of.given is None else of.given),
        **building.params(options.param),
    }
    try:
        with solver_of("z3", LIMITS) as solver:
            return [
                one for at in violated for one in suggestions(checked.source, checked.program, at, given, found, solver)
            ]
    except SolverMissing as error:
        line.end()
        console.notify(f"note: {error}: no weaker assumptions are suggested, because they cannot be proved")
        return []


def _print_report(
    options: Namespace,
    found: table.ValidationReport,
    out: Path,
    whole: bool,
    reach: Mapping[str, Any],
) -> None:
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
        # If the validation ended early, the caller reports the reason, which matters more than this error.
        if whole:
            raise
    if options.format == "json":
        print(json.dumps(document, indent=2), flush=True)
    else:
        print(coloured_verdicts(text, sys.stdout), end="")
        print(f"report and runs are in {out}" + (f"; picture: {found.picture}" if found.picture else ""))


# `koordgen validate --reachsets`: computes the positions that each platform can reach on the path to a target.

FOLDER, RUNS = "reachsets", "probes"


def _reachsets(options: Namespace, fleet: str, out: Path, line: ProgressLine) -> dict[str, Any]:
    """Compute and write the reachsets of all platforms of the fleet. Reachsets of an earlier command are replaced.

    Return for the JSON report: the offset, the written files, the comparisons of platforms, and under `text` a table.
    Raises Failure, OSError, ClusterUnreachable."""
    folder = out / FOLDER
    asked = ReachsetRequest(options.offset, options.epsilon, options.gamma, options.seed)
    show: Callable[[str], None] = (lambda _: None) if options.quiet else (lambda text: line.show(f"reachsets: {text}"))
    try:
        with closing(campaigns._executor(options)) as executor, campaigns._recorded_signals() as received:
            runs = store.cleared(folder / RUNS)
            found = reachsets(fleet, (), asked, executor, runs, show, lambda: bool(received))
        files = write_files(found, folder)
    except BadProbe as error:
        raise console.Failure(console.SURROUNDINGS, str(error), error.help) from None
    except drive.DiskFull:
        raise console.Failure(
            console.SURROUNDINGS, f"{folder}: the disk is full", "free disk space, then repeat the command"
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
