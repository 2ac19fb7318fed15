"""Suggested assumptions: weaker than a violated assumption, and satisfied in all simulation runs of a validation.

Each suggestion has the verdicts of the program's invariants under the suggested assumption.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from textwrap import shorten

from koordgen.experiment.validate.samples import RunSample, margin
from koordgen.lang.analyze.params import Value, with_params
from koordgen.lang.analyze.program import check
from koordgen.lang.ir import decl
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.tree import walk
from koordgen.lang.ir.types import POINT
from koordgen.lang.source import Source, Span
from koordgen.lang.syntax.parse import parse
from koordgen.verify.prove.report.show import suggestion as missing
from koordgen.verify.prove.report.verdict import Question, prove
from koordgen.verify.prove.smt.solve import CrossCheck, Solver

STEP = 0.01  # suggested margins are rounded up to multiples of this length, in metres
MOST_SAID = 140  # largest number of characters of the reason for a prover's verdict; longer reasons are shortened


@dataclass(frozen=True)
class Proved:
    """The prover's verdict of one invariant under a suggested assumption.

    `missing`: additional facts that would prove the invariant, or the reason for the verdict; "" if neither is
        known."""

    invariant: str
    verdict: str
    missing: str


@dataclass(frozen=True)
class Suggestion:
    """Suggested assumption, which replaces an assumption that simulation runs violated.

    `line`: line of the replaced assumption in the program.
    `margin`: radius in metres of the ball around the target, within which all robots stayed.
    `by_platform`: platform -> the margin that its robots need, in metres.
    `proved`: the prover's verdicts under the suggested assumption."""

    module: str
    line: int
    text: str
    by_platform: Mapping[str, float]
    margin: float
    proved: tuple[Proved, ...]

    @property
    def closes(self) -> bool:
        """Return whether the prover proves all invariants under the suggested assumption."""
        return all(p.verdict == "PROVED" for p in self.proved)


def about_way(program: decl.Program, line: int) -> decl.Assumption | None:
    """Return the assumption at a line of the program if the assumption bounds a robot's path to its target.

    Such an assumption relates the ports `position'`, `position` and `target`, and no other ports. Returns None for any
    other assumption."""
    for module in program.modules:
        for assumption in module.assumptions:
            read = {(n.port, n.primed) for n in walk(assumption.formula) if isinstance(n, ir.PortRead)}
            points = {p.name for p in module.ports if p.type == POINT}
            way = {("position", True), ("position", False), ("target", False)}
            goes = ("position", True) in read and ("target", False) in read
            if assumption.span.line == line and goes and read <= way and {"position", "target"} <= points:
                return assumption
    return None


def suggestions(
    source: Source,
    program: decl.Program,
    line: int,
    params: Mapping[str, Value],
    samples: Sequence[RunSample],
    solver: Solver | CrossCheck,
) -> list[Suggestion]:
    """Suggest two weaker replacements for the assumption at a line of the program.

    The assumption must bound a robot's path to its target; otherwise, the list is empty. The first replacement allows
    the box from position to target and a ball around the target; the second allows only the ball. Raises SolverMissing.

    The box is not enlarged, because a margin around the robot's position would grow from round to round. Then no
    invariant about positions could be proved."""
    old = about_way(program, line)
    if old is None:
        return []
    module = next(m.name for m in program.modules if old in m.assumptions)
    found = []
    for outside, text in (
        (True, "position' in Rect(position, target) or position' in Ball(target, {})"),
        (False, "position' in Ball(target, {})"),
    ):
        platforms = dict.fromkeys(p for sample in samples for p in sample.platforms)
        own = {platform: _up(margin(samples, platform, outside=outside)) for platform in platforms}
        most = max(own.values(), default=0.0)
        formula = text.format(f"{most:g}")
        proved = _proved(_with(source, old.formula.span, formula), params, solver)
        found.append(Suggestion(module, line, formula, own, most, tuple(proved)))
    return found


def _up(metres: float) -> float:
    return round(math.ceil(metres / STEP - 1e-9) * STEP, 6)


def _proved(program: decl.Program, params: Mapping[str, Value], solver: Solver | CrossCheck) -> list[Proved]:
    """Prove the invariants of a program with the values of params that the simulated fleet has."""
    fixed = {p.name: p.default for p in with_params(program, params).params}
    found = prove(Question(program, None, fixed), solver)
    return [Proved(v.invariant, v.verdict, missing(v) or shorten(v.reason, MOST_SAID)) for v in found]


def _with(source: Source, span: Span, formula: str) -> decl.Program:
    """Replace the formula at `span` in a program's text by `formula`, and return the checked program."""
    lines = source.text.split("\n")
    first, last = lines[span.line - 1], lines[span.end_line - 1]
    whole = first[: span.column - 1] + formula + last[span.end_column - 1 :]
    text = "\n".join([*lines[: span.line - 1], whole, *lines[span.end_line :]])
    changed = Source(source.path, text)
    tree, unread = parse(changed)
    program, found = check(tree, changed)
    assert program is not None and not unread, found
    return program
