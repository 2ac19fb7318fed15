"""Report of a validation: formatted as text of at most 120 columns, and as JSON."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from koordgen.experiment.validate.breach import EXPLANATIONS
from koordgen.experiment.validate.suggest import Suggestion
from koordgen.experiment.validate.verdict import AssumptionVerdict, Case, ProbabilityBound

FORMAT = "koord-validation/1"
WORST = ("VIOLATED", "INCONCLUSIVE", "VALIDATED")


@dataclass(frozen=True)
class ValidationReport:
    """Report of one validation: the validated program and fleet, the simulation runs, and the verdicts.

    `samples`, `finished`: numbers of started and of finished runs.
    `seed`: seed of the first run.
    `seconds`: duration of a run.
    `start_noise`: half-width of the random starts around the fleet file's starts, in metres and radians.
    `failed`: reason for the first failure of a run; "" if all runs finished.
    `texts`: line of the program -> text of the assumption.
    `unchecked`: (line, reason) of each assumption that cannot be evaluated.
    `hashes`: of the program, under the name "", and of the programs of each squad."""

    program: str
    fleet: str
    bound: ProbabilityBound
    samples: int
    finished: int
    seed: int
    seconds: float
    start_noise: float
    failed: str
    texts: Mapping[int, str]
    verdicts: Sequence[AssumptionVerdict]
    unchecked: Sequence[tuple[int, str]]
    suggestions: Sequence[Suggestion]
    picture: str = ""
    hashes: Mapping[str, str] = field(default_factory=dict)

    @property
    def verdict(self) -> str:
        """Return the verdict of the whole validation: the worst verdict of its assumptions."""
        said = {v.verdict for v in self.verdicts} | ({"INCONCLUSIVE"} if self.unchecked or not self.verdicts else set())
        return next(name for name in WORST if name in said)


Commands = Callable[[Case], tuple[str, str]]


def as_text(found: ValidationReport, commands: Commands) -> str:
    """Return the report of a validation as text.

    `commands`: returns two command lines for a violated case: one runs the case again, one replays it."""
    lines = [*_head(found), ""]
    for line in dict.fromkeys(v.assumption.line for v in found.verdicts):
        lines += [*_assumption(found, [v for v in found.verdicts if v.assumption.line == line], commands), ""]
    for line, why in found.unchecked:
        lines += [f"INCONCLUSIVE  {found.program}:{line}: {found.texts.get(line, '')}: cannot be evaluated: {why}", ""]
    if found.suggestions:
        lines += [*_suggestions(found), ""]
    if found.failed:
        lines.append(f"some runs did not finish; the first reason: {found.failed}")
    lines.append(f"{found.verdict}: {_claim(found)}")
    return "\n".join(line.rstrip() for line in lines) + "\n"


def _head(found: ValidationReport) -> Iterator[str]:
    last = found.seed + found.samples - 1
    yield (
        f"{found.program} on {found.fleet}: {found.finished} of {found.samples} runs of {found.seconds:g} s, "
        f"seeds {found.seed} to {last}"
    )
    noise = found.start_noise
    yield (
        f"starts: drawn within {noise:g} m (and rad) of the fleet file's, anew for each run"
        if noise
        else "starts: the fleet file's, the same in each run: `sim: {start_noise: 0.3}` draws them"
    )


def _claim(found: ValidationReport) -> str:
    bound = found.bound
    says = f"a run from these starts violates an assumption with a probability below {bound.epsilon:g}"
    if found.verdict == "VALIDATED":
        return f"with confidence {1 - bound.gamma:g}, {says} ({bound.needed} or more runs had no violation)"
    if found.verdict == "VIOLATED":
        platforms = ", ".join(dict.fromkeys(v.platform for v in found.verdicts if v.verdict == "VIOLATED"))
        return f"a proof that uses these assumptions does not cover {platforms}"
    needed = f"{bound.needed} runs without a violation are needed"
    why = f"{bound.needed} >= ln(1/{bound.gamma:g})/{bound.epsilon:g}"
    return f"to show with confidence {1 - bound.gamma:g} that {says}, {needed} ({why})"


def _assumption(found: ValidationReport, verdicts: Sequence[AssumptionVerdict], commands: Commands) -> Iterator[str]:
    about = verdicts[0].assumption
    yield f"{about.module} ({found.program}:{about.line}): {found.texts.get(about.line, '')}"
    percent = 100 * (1 - found.bound.gamma)
    head = (
        "platform",
        "verdict",
        "runs",
        "violated",
        f"a run violates ({percent:g} %)",
        "windows",
        "violated",
        "in a window",
        "in a row",
    )
    yield from _columns([head, *map(_cells, verdicts)])
    for verdict in verdicts:
        if verdict.why:
            yield f"  {verdict.platform}: {verdict.why}"
        if verdict.out_of_model:
            yield f"  {verdict.platform}: {verdict.out_of_model} further windows: the robot had left the model"
        yield from _breaches(verdict)
        if verdict.worst is not None:
            yield from _case(verdict, verdict.worst, commands)
    yield "  Windows of a run are not independent of one another; the interval is over runs (Clopper-Pearson)."


def _cells(verdict: AssumptionVerdict) -> tuple[str, ...]:
    low, high = verdict.interval
    outside = [f"{max(m.values()):.3f} m" if m else "-" for m in (verdict.farthest, verdict.together)]
    return (
        verdict.platform, verdict.verdict, str(verdict.runs), str(verdict.violated), f"{low:.3g} to {high:.3g}",
        str(verdict.windows), str(verdict.violated_windows), *outside,
    )  # fmt: skip


def _columns(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    for row in rows:
        words = [cell.ljust(w) if k < 2 else cell.rjust(w) for k, (cell, w) in enumerate(zip(row, widths, strict=True))]
        yield f"  {'  '.join(words)}"


def _breaches(verdict: AssumptionVerdict) -> Iterator[str]:
    for kind, count in sorted(verdict.breaches.items(), key=lambda item: -verdict.farthest[item[0]]):
        row = f", {verdict.together[kind]:.3f} m in a row" if kind in verdict.together else ""
        most = f"{verdict.farthest[kind]:.3f} m outside the box in one{row}"
        yield f"  {verdict.platform}: {kind}, {count} windows, at most {most}"
        yield f"    {EXPLANATIONS[kind]}"  # type: ignore[index]


def _case(verdict: AssumptionVerdict, case: Case, commands: Commands) -> Iterator[str]:
    how = ""
    if case.breach is not None:
        x, y, z = case.breach.out
        row = (
            f", {case.breach.together:.3f} m with the windows before"
            if case.breach.together > case.breach.distance
            else ""
        )
        far = f"{case.breach.distance:.3f} m outside the box{row}"
        how = f": {far}, by ({x:.3f}, {y:.3f}, {z:.3f}) m, kind {case.breach.main}"
    yield f"  {verdict.platform}: {case.robot}, run {case.run:04d} (seed {case.seed}), at {case.at:.2f} s{how}"
    run, replay = commands(case)
    yield f"    {run}"
    yield f"    {replay}"


def _suggestions(found: ValidationReport) -> Iterator[str]:
    seen = max((v.runs for v in found.verdicts), default=0)
    epsilon = max((v.epsilon for v in found.verdicts), default=1.0)
    kept = f"all of these {seen} runs" if seen > 1 else "this one run"
    yield (
        f"weaker, and kept in {kept}: with confidence {1 - found.bound.gamma:g} a further run needs "
        f"more than its platform's margin with a probability below {epsilon:.3g}"
    )
    for line in dict.fromkeys(s.line for s in found.suggestions):
        own = [s for s in found.suggestions if s.line == line]
        for suggestion in own:
            by = ", ".join(f"{platform} {margin:g} m" for platform, margin in suggestion.by_platform.items())
            yield f"  using {suggestion.module}: assume {suggestion.text}"
            yield f"    margin: {by}"
            yield from (f"    {line}" for line in _proofs(suggestion))
        yield f"  {_closes(own)}"


def _proofs(suggestion: Suggestion) -> Iterator[str]:
    for proved in suggestion.proved:
        yield f"{proved.verdict}  {proved.invariant}" + (f": {proved.missing}" if proved.missing else "")


def _closes(own: Sequence[Suggestion]) -> str:
    proper = [p for p in own[0].proved if not p.invariant.startswith("(")]
    if not proper:
        return "The program has no invariant that could be proved with a suggested assumption."
    closing = [s.text for s in own if s.closes]
    if closing:
        return f"The prover proves all invariants with: assume {closing[0]}"
    return (
        "The prover proves all invariants with neither suggestion. Constrain the motion more, with a velocity or a "
        "braking term, or weaken the invariant by the margin."
    )


def document(found: ValidationReport, commands: Commands) -> dict[str, Any]:
    """Return the report of a validation as a JSON object.

    `commands`: returns two command lines for a violated case: one runs the case again, one replays it."""
    return {
        "format": FORMAT,
        "program": found.program,
        "hashes": dict(found.hashes),
        "fleet": found.fleet,
        "verdict": found.verdict,
        "epsilon": found.bound.epsilon,
        "gamma": found.bound.gamma,
        "needed": found.bound.needed,
        "samples": found.samples,
        "finished": found.finished,
        "seed": found.seed,
        "seconds": found.seconds,
        "start_noise": found.start_noise,
        "failed": found.failed,
        "picture": found.picture,
        "assumptions": [_verdict(found, v, commands) for v in found.verdicts],
        "unchecked": [{"line": line, "why": why} for line, why in found.unchecked],
        "suggestions": [{**asdict(s), "closes": s.closes} for s in found.suggestions],
    }


def _verdict(found: ValidationReport, verdict: AssumptionVerdict, commands: Commands) -> dict[str, Any]:
    plain = asdict(verdict)
    about = plain.pop("assumption")
    worst = verdict.worst
    if worst is not None:
        run, replay = commands(worst)
        plain["worst"] |= {"command": run, "replay": replay}
        if worst.breach is not None:
            plain["worst"]["breach"]["distance"] = worst.breach.distance
    return {"module": about["module"], "line": about["line"], "text": found.texts.get(about["line"], ""), **plain}
