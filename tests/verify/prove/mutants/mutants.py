"""Runner of mutants of the prover: each breaks one rule of docs/reference/semantics.md, "Verification conditions", in
one line.

With an unsound mutant something is PROVED that is false: the attack, an exploration or random runs must contradict it.
Any other mutant must change the known verdict of a small program. `python -m tests.verify.prove.mutants.mutants` prints
all mutants and what catches each; with `--random 120` by random programs alone, in 120 seconds for each mutant.
"""

from __future__ import annotations

import inspect
import sys
import textwrap
import time
from argparse import ArgumentParser
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import count
from types import FunctionType
from typing import Any, NamedTuple, TextIO
from unittest.mock import patch

from koordgen.lang.ir.decl import Program
from koordgen.verify.attack.attack import attack
from koordgen.verify.explore.environment import MissingEnvironment
from koordgen.verify.prove.report import verdict
from koordgen.verify.prove.report.verdict import Question, prove
from koordgen.verify.prove.smt.solve import Limits, Solver
from koordgen.verify.replay.functions import CannotCall
from tests.verify.attack.faults import ticks
from tests.verify.prove.mutants.catalogue import MUTANTS, Mutant
from tests.verify.prove.mutants.programs import PROGRAMS, VERDICTS
from tests.verify.prove.proving import checked, proved_names
from tests.verify.prove.randomly.judges import Effort, Overtime, _within, explored, ran
from tests.verify.prove.randomly.programs import program as random_program

SECONDS = 120.0  # in which each mutant is caught
EFFORT = Effort()
JUDGES = {"exploration": explored, "run": ran}
LIMITS = Limits(query=1.0, total=100_000.0)


class Caught(NamedTuple):
    """`judge`: "attack", "exploration", "run" or "battery"; `program`: its name, or "seed N"; the invariant that was
    wrongly PROVED; seconds since the search for it began."""

    judge: str
    program: str
    invariant: str
    seconds: float


@contextmanager
def planted(mutant: Mutant) -> Iterator[None]:
    """The prover with one line changed. Raises ValueError where the line does not stand once in its function."""
    function = inspect.unwrap(mutant.where)
    assert isinstance(function, FunctionType)
    source = textwrap.dedent(inspect.getsource(function))
    if source.count(mutant.line) != 1:
        raise ValueError(f"{source.count(mutant.line)} times in {function.__qualname__}: {mutant.line}")
    changed = compile(
        source.replace(mutant.line, mutant.instead), inspect.getfile(function), "exec",
        annotations.compiler_flag, True,
    )  # fmt: skip
    made: dict[str, Any] = {}
    exec(changed, function.__globals__, made)
    wrapped = made[function.__name__]
    getter: Any = wrapped.fget if isinstance(wrapped, property) else wrapped
    other: Any = inspect.unwrap(getter)
    kept, function.__code__ = function.__code__, other.__code__
    try:
        yield
    finally:
        function.__code__ = kept


def proved(program: Program, solver: Solver) -> frozenset[str]:
    """Return the names of the invariants that are PROVED. Failures are not explained, because that takes long."""
    with patch.object(verdict, "_explained", lambda *_: {}):
        return frozenset(v.invariant for v in prove(Question(program), solver) if v.verdict == "PROVED")


def contradicted(program: Program, solver: Solver, seed: int, judges: Iterable[str]) -> tuple[str, str] | None:
    """The judge that contradicts a verdict, and the invariant. The attack has its default budget, counted in work."""
    names = proved(program, solver)
    for judge in judges if names else ():
        if judge == "attack":
            said = attack(program, names, solver=solver, clock=ticks(), seed=seed).contradiction
            if said is not None:
                return judge, said.breach.invariant
            continue
        try:
            found = JUDGES[judge](program, names, seed, EFFORT)
        except (CannotCall, MissingEnvironment):
            continue
        if found is not None:
            return judge, found.invariant
    return None


def fixed(mutant: Mutant, solver: Solver, names: Iterable[str]) -> Caught | None:
    """The first of the fixed programs that shows the mutant wrong: by the attack, or by the verdicts of the battery."""
    began = time.monotonic()
    for name in names:
        if mutant.unsound:
            found = contradicted(checked(PROGRAMS[name]), solver, 0, ("attack", "exploration"))
            if found is not None:
                return Caught(found[0], name, found[1], time.monotonic() - began)
        elif name in VERDICTS:
            text, wanted = VERDICTS[name]
            wrong = proved_names(checked(text), solver) ^ wanted
            if wrong:
                return Caught("battery", name, min(wrong), time.monotonic() - began)
    return None


def by_chance(solver: Solver, first: int, seconds: float) -> Caught | None:
    """The first random program, of the seeds from `first` on, that shows the planted mutant wrong."""
    began = time.monotonic()
    for seed in count(first):
        if time.monotonic() > began + seconds:
            return None
        try:
            with _within(EFFORT.proving):
                found = contradicted(random_program(seed).program, solver, seed, ("attack", *JUDGES))
        except Overtime:
            solver.__exit__()
            continue
        if found is not None:
            return Caught(found[0], f"seed {seed}", found[1], time.monotonic() - began)
    return None


def caught(mutant: Mutant, solver: Solver, seconds: float = SECONDS) -> Caught | None:
    """What shows a mutant wrong: the program that is named beside it, any other fixed one, or a random one."""
    with planted(mutant):
        found = fixed(mutant, solver, dict.fromkeys((mutant.program, *PROGRAMS)))
        return by_chance(solver, 0, seconds) if found is None and mutant.unsound else found


def table(solver: Solver, seconds: float, by_random: bool, out: TextIO) -> int:
    """Write a line for each mutant, by rule, and return how many were not caught."""
    wrong = 0
    for name, mutant in MUTANTS.items():
        if by_random and not mutant.unsound:
            continue
        if by_random:
            with planted(mutant):
                found = by_chance(solver, 0, seconds)
        else:
            found = caught(mutant, solver, seconds)
        wrong += found is None
        proved_names = f"{found.judge}: {found.program} ({found.seconds:.1f} s)" if found else f"NOT in {seconds:g} s"
        kind = "unsound" if mutant.unsound else "weaker"
        print(f"{mutant.rule:6} {kind:7} {name:76} {proved_names}", file=out, flush=True)
    return wrong


def main() -> int:
    parser = ArgumentParser(prog="python -m tests.verify.prove.mutants.mutants")
    parser.add_argument("--random", type=float, metavar="SECONDS", help="by random programs alone")
    options = parser.parse_args()
    with Solver("z3", LIMITS) as solver:
        return 1 if table(solver, options.random or SECONDS, options.random is not None, sys.stdout) else 0


if __name__ == "__main__":
    sys.exit(main())
