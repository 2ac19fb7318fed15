"""Campaign of random programs: searches PROVED invariants that a run breaks, and internal errors.

    python -m tests.verify.prove.campaign --from 0 --count 20000 --folder build/prover-campaign

Results go into a file of JSON lines for each slice of seeds. Run again, it goes on where it ended; a process that is
killed loses one program. Each contradiction and each internal error is a file of its own, with a program made small.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import subprocess
import sys
from argparse import ArgumentParser, Namespace
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from koordgen.verify.prove.smt.solve import CrossCheck, Limits, solver_of
from tests.verify.prove.randomly.constructs import constructs
from tests.verify.prove.randomly.judges import Effort, Judged, judged
from tests.verify.prove.randomly.programs import Made, checked, program
from tests.verify.prove.randomly.shrink import shrunk

SLICE = 250  # programs of one file
TRIES = 250  # texts that are looked at to make one program small
PATIENCE = 20.0  # seconds of making one program small
REFUTED = {"FALSIFIED", "NOT INDUCTIVE"}
CONSTRUCTS_WIDTH = 40
# The constructs by which contradictions are told apart.
TELLING = (
    "loop in event", "loop in init", "loop in function", "invariant of a loop", "priority", "planner that is called",
    "target without position",
)  # fmt: skip


class Runner:
    """Judges programs of one solver, one after another."""

    def __init__(self, solver: str, seconds: float) -> None:
        self.seconds = seconds
        self.effort = Effort(seconds=seconds / 15, explaining=seconds / 60, attacking=seconds / 16, proving=4 * seconds)
        self.solver = solver_of(solver, Limits(query=2 * seconds))
        self.commit = commit()

    def judged(self, made: Made, seed: int) -> Judged:
        """Judge one program; the solvers have their time for this program anew."""
        for one in self.solver.solvers if isinstance(self.solver, CrossCheck) else (self.solver,):
            one.limits = one.limits._replace(total=one.spent + 4 * self.seconds)
        return judged(made.program, self.solver, seed, self.effort)

    def end(self) -> None:
        self.solver.__exit__()

    def small(self, made: Made, seed: int, first: Judged) -> str:
        """The smallest text found that has a contradiction or an internal error of the same kind."""
        kind = kind_of(first)

        def still(text: str) -> bool:
            again = checked(text)
            return again is not None and kind_of(self.judged(Made(text, again, 0), seed)) == kind

        return shrunk(made.text, still, TRIES, PATIENCE)


def commit() -> str:
    """The commit of koordgen that is judged; empty outside of a repository."""
    asked = ["git", "-C", str(Path(__file__).parent), "rev-parse", "--short=10", "HEAD"]
    return subprocess.run(asked, capture_output=True, text=True).stdout.strip()


def kind_of(found: Judged) -> str:
    """Return "contradiction", or the exception and where it arose; empty where nothing is wrong."""
    if found.contradictions:
        return "contradiction"
    lines = [line for line in found.fault.splitlines() if line.strip()]
    places = [line.split(", ") for line in lines if line.strip().startswith("File ")]
    where = f"{Path(places[-1][0].strip()[6:-1]).name} {places[-1][2]}" if places else ""
    return f"internal error: {lines[-1].split(':')[0]} {where}" if lines else ""


def record(runner: Runner, seed: int, folder: Path) -> dict[str, Any]:
    """One program, judged; what is wrong with it goes into a file of its own."""
    made = program(seed)
    found = runner.judged(made, seed)
    kind, small = kind_of(found), ""
    if kind:
        small = runner.small(made, seed, found)
        again = checked(small)
        assert again is not None
        write_finding(
            folder / f"{seed:06d}.koord", seed, kind, small, made.text, runner.judged(Made(small, again, 0), seed)
        )
    return {
        "seed": seed, "refused": made.refused, "verdicts": found.verdicts, "kind": kind, "skipped": found.skipped,
        "constructs": constructs(made.text), "left": constructs(small) if kind else [],
        "seconds": {name: round(value, 4) for name, value in found.seconds.items()}, "commit": runner.commit,
    }  # fmt: skip


def write_finding(path: Path, seed: int, kind: str, small: str, whole: str, found: Judged) -> None:
    """A program that is wrong, with what was found as comments."""
    told = [
        f"{c.invariant} is PROVED, and false in a {c.judge} of {c.robots} robots\n{c.story}"
        for c in found.contradictions
    ]
    story = "\n".join(
        [
            kind,
            f"seed {seed}: python -m tests.verify.prove.campaign --from {seed} --count 1 --folder /tmp/again",
            *told,
            found.fault,
        ]
    )
    comments = "\n".join(f"# {line}" for line in story.splitlines())
    whole_too = "\n".join(f"# {line}" for line in f"the program as it was written:\n{whole}".splitlines())
    path.write_text(f"{comments}\n{small}\n{whole_too}\n")


# Slices


def slices(first: int, count: int) -> list[range]:
    """The seeds, in slices that begin at multiples of SLICE."""
    ends = [first, *range((first // SLICE + 1) * SLICE, first + count, SLICE), first + count]
    return [range(a, b) for a, b in pairwise(ends) if a < b]


def file_of(folder: Path, solver: str, seed: int) -> Path:
    return folder / f"{solver}-{seed // SLICE * SLICE:06d}.jsonl"


def lines_of(path: Path) -> list[dict[str, Any]]:
    """The whole lines of a slice's file; a last one that was cut off is taken away from it."""
    if not path.exists():
        return []
    text = path.read_text()
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        path.write_text(whole)
    return [json.loads(line) for line in whole.splitlines()]


def run_slices(todo: Sequence[range], options: Namespace) -> None:
    """Judges what is not judged yet."""
    folder = Path(options.folder)
    runner = Runner(options.solver, options.seconds)
    for seeds in todo:
        path = file_of(folder, options.solver, seeds[0])
        done = {line["seed"] for line in lines_of(path)}
        with path.open("a") as file:
            for seed in seeds:
                if (parent := multiprocessing.parent_process()) is not None and not parent.is_alive():
                    return  # the command was killed
                if seed not in done:
                    file.write(json.dumps(record(runner, seed, folder)) + "\n")
                    file.flush()
                    os.fsync(file.fileno())
                if sys.stderr.isatty():
                    sys.stderr.write(f"\rseed {seed} of slice {seeds[0]} to {seeds[-1]} ")
                    sys.stderr.flush()
    runner.end()


# The summary


def results(options: Namespace) -> Iterator[dict[str, Any]]:
    """The results for the seeds that were asked for."""
    for seeds in slices(options.first, options.count):
        for line in lines_of(file_of(Path(options.folder), options.solver, seeds[0])):
            if line["seed"] in seeds:
                yield line


def summary(lines: Sequence[dict[str, Any]]) -> str:
    """Tables of the verdicts, of what is wrong, and of the coverage by construct."""
    verdicts = Counter(verdict for line in lines for verdict in line["verdicts"].values())
    kinds = Counter(line["kind"] for line in lines if line["kind"])
    left = Counter(_what(line["left"]) for line in lines if line["kind"] == "contradiction")
    spent: Counter[str] = Counter()
    for line in lines:
        spent.update(line["seconds"])
    skipped = Counter(
        reason.split(":")[0] + ":" + reason.split(":")[1][:40] for line in lines for reason in line["skipped"]
    )
    many = max(len(lines), 1)
    refused = sum(line["refused"] for line in lines)
    rows = [f"programs                {len(lines)}"]
    rows += [f"  of commit {name:12}{number}" for name, number in Counter(line["commit"] for line in lines).items()]
    rows += [f"  {verdict:22}{number}" for verdict, number in verdicts.most_common()]
    rows += [f"contradictions          {kinds['contradiction']}"]
    rows += [f"internal errors         {sum(kinds.values()) - kinds['contradiction']}"]
    rows += [f"  {number:5}  {kind}" for kind, number in kinds.most_common() if kind != "contradiction"]
    rows += [f"  {number:5}  contradicting programs, made small, have: {kind}" for kind, number in left.most_common(40)]
    rows += [f"not judged: {reason}   {number}" for reason, number in skipped.most_common(12)]
    rows += [f"seconds a program       {sum(spent.values()) / many:.3f}"]
    rows += [f"  {name:22}{seconds / many:.3f}" for name, seconds in spent.most_common()]
    rows += [f"texts the checker refused, of all texts: {refused / (refused + many):.1%}", "", *coverage(lines)]
    return "\n".join(rows)


def _what(left: Sequence[str]) -> str:
    """Return the constructs of TELLING that a contradicting program still has when it is small."""
    return " + ".join(name for name in TELLING if name in left) or "none of these: " + ", ".join(left)


def coverage(lines: Sequence[dict[str, Any]]) -> list[str]:
    """A table: how many programs have a construct, in how many of these something is PROVED, and refuted."""
    having: Counter[str] = Counter()
    proved: Counter[str] = Counter()
    refuted: Counter[str] = Counter()
    for line in lines:
        own = {v for name, v in line["verdicts"].items() if not name.startswith("(")}
        having.update(line["constructs"])
        proved.update(line["constructs"] if "PROVED" in own else ())
        refuted.update(line["constructs"] if own & REFUTED else ())
    rows = [f"{'construct':{CONSTRUCTS_WIDTH}} programs  PROVED  refuted"]
    return rows + [
        f"{name:{CONSTRUCTS_WIDTH}} {n:8}  {proved[name]:6}  {refuted[name]:7}" for name, n in sorted(having.items())
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is left to run, print the summary; 1 where anything is wrong."""
    parser = ArgumentParser(
        prog="python -m tests.verify.prove.campaign", description=__doc__.split("\n")[0] if __doc__ else ""
    )
    parser.add_argument("--from", dest="first", type=int, default=0, help="the first seed")
    parser.add_argument("--count", type=int, default=20_000, help="how many programs")
    parser.add_argument("--folder", default="build/prover-campaign", help="where the results are kept")
    parser.add_argument("--jobs", type=int, default=1, help="how many processes")
    parser.add_argument("--solver", choices=("z3", "cvc5", "both"), default="z3")
    parser.add_argument(
        "--seconds", type=float, default=0.5, help="of a program; its proof is given up after 4 times as many"
    )
    options = parser.parse_args(arguments)
    Path(options.folder).mkdir(parents=True, exist_ok=True)
    todo = slices(options.first, options.count)
    if options.jobs == 1:
        run_slices(todo, options)
    else:
        context = multiprocessing.get_context("spawn")
        crew = [
            context.Process(target=run_slices, args=(todo[k :: options.jobs], options)) for k in range(options.jobs)
        ]
        for process in crew:
            process.start()
        for process in crew:
            process.join()
        if any(process.exitcode for process in crew):
            print("a process of the campaign ended early; run it again to go on", file=sys.stderr)
            return 1
    lines = list(results(options))
    print(summary(lines))
    return 1 if any(line["kind"] for line in lines) else 0


if __name__ == "__main__":
    sys.exit(main())
