"""`koordgen explore`: what is asked, what is printed, and the exit status."""

from __future__ import annotations

import json
import sys
import time
from argparse import Namespace
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from koordgen.build.emit.program import functions_module
from koordgen.build.pipeline import Checked, Rejected, check_file, read_fleet, read_source
from koordgen.cli.base.alarm import alarm
from koordgen.cli.base.building import params
from koordgen.cli.base.console import (
    HOLDS,
    INCONCLUSIVE,
    INTERRUPTED,
    USAGE,
    VIOLATED,
    WRONG,
    Failure,
    print_diagnostics,
)
from koordgen.cli.base.terminal import ProgressLine, coloured_verdicts
from koordgen.cli.verify.prove import hash_of, save
from koordgen.fleet import manifest
from koordgen.lang.analyze.params import BadParam, with_params
from koordgen.lang.diagnostics import Diagnostic
from koordgen.lang.ir.decl import Program
from koordgen.lang.semantics.deadline import OutOfTime
from koordgen.lang.semantics.relations import is_order_of_agents
from koordgen.lang.semantics.state import World, nobody
from koordgen.lang.source import Source, Span
from koordgen.verify.explore.envfile import environment
from koordgen.verify.explore.environment import Environment, Lacking, Surroundings, answering
from koordgen.verify.explore.machine import Machine
from koordgen.verify.explore.search import DEADLOCK, Bounds, Progress, Result, Search, Violation
from koordgen.verify.explore.show import document, itf, report, told, trace
from koordgen.verify.prove.report.trace import About
from koordgen.verify.replay.functions import CannotCall, externs

ROBOTS = 3  # where neither --robots nor a fleet says how many
MORE = 10_000  # states, or as many as there are, that are looked at for a run that agents can do


def explore(options: Namespace) -> int:
    """The whole command."""
    checked = check_file(options.program)
    if options.format == "text":
        print_diagnostics([(checked.source, d) for d in checked.diagnostics], options)
    robots, from_fleet = _fleet(options, checked)
    try:
        around = _environment(options, checked.program, robots)
        given = {**from_fleet, **around.params, **params(options.param)}
        program = with_params(checked.program, given)
        result = _searched(options, program, robots, around, lambda: _about(options, program, robots, around, given))
    except BadParam as error:
        raise Failure(USAGE, str(error)) from None
    except Lacking as error:
        raise Failure(USAGE, str(error), "`koordgen docs explore` explains such a file") from None
    if options.format == "json":
        print(json.dumps(document(result, program, robots), indent=2), flush=True)
    else:
        sys.stdout.write(coloured_verdicts(report(result, program, options.program, robots), sys.stdout))
        sys.stdout.flush()
    if result.violation is not None:  # told before: a file that cannot be written costs nothing of a long search
        if options.trace:
            about = _about(options, program, robots, around, given)
            save(options.trace, trace(result.violation, program, about))
        if options.itf:
            save(options.itf, itf(result.violation, program))
    return _status(result)


def _about(options: Namespace, program: Program, robots: int, around: Environment, given: Iterable[str]) -> About:
    """What a run that was found was made with."""
    hashed, functions = hash_of(program, options.program, options.functions)
    return About(hashed, tuple(given), answering(around, program, robots), externs(program, functions))


def _searched(
    options: Namespace, program: Program, robots: int, around: Environment, about: Callable[[], About]
) -> Result:
    line = ProgressLine(sys.stderr)

    def show(progress: Progress) -> None:
        rate = progress.states / max(progress.seconds, 1e-9)
        line.show(f"depth {progress.depth}: {told(progress)}, {rate:,.0f} states/s")

    functions = options.functions or Path(options.program).with_name(f"{functions_module(program)}.py")
    bounds = Bounds(options.rounds, options.states, options.seconds)
    started = time.monotonic()

    def left() -> float | None:
        return None if options.seconds is None else max(0.0, options.seconds - (time.monotonic() - started))

    try:
        machine = Machine(program, robots, answering(around, program, robots), Path(functions))
        surroundings = Surroundings(machine, around)
        search = Search(
            machine, surroundings, bounds, time.monotonic, show,
            symmetry=options.symmetry, independence=options.independence, deadlock=options.deadlock,
            forgetting=options.forgetting,
        )  # fmt: skip
        with alarm(bounds.seconds):
            result = search.run()
        found = result.violation
        if found is None or _of_agents(found, program, about(), left()):
            return result
        found = found._replace(of_agents=False)
        machine.discards.clear()
        further = _further(bounds, found, result.progress)
        second = Search(
            machine, surroundings, further, time.monotonic, show, deadlock=found.name == DEADLOCK, as_agents=True,
        )  # fmt: skip
        with alarm(further.seconds):
            again = second.run().violation
        if again is None or again.name != found.name or not _of_agents(again, program, about(), left()):
            return result._replace(violation=found)
        rounds = found.moments[-1].round
        more = rounds < again.moments[-1].round
        return result._replace(violation=again._replace(shortest=rounds if more else None))
    except CannotCall as error:
        raise Failure(WRONG, str(error), "name it with --functions") from None
    finally:
        line.end()


def _further(bounds: Bounds, found: Violation, progress: Progress) -> Bounds:
    """How far a run is looked for among those that agents can do. What is one round of the language may take one of
    theirs for each robot: they commit one transaction for each lock in a round."""
    states = max(MORE, progress.states)
    seconds = None if bounds.seconds is None else max(0.0, bounds.seconds - progress.seconds)
    rounds = found.moments[-1].round * len(found.moments[0].state.robots)
    return Bounds(rounds, min(states, bounds.states or states), seconds)


def _of_agents(found: Violation, program: Program, about: About, seconds: float | None) -> bool:
    """Return whether agents can do each round of a run; an event without a result is a part of it. Where that takes
    more than
    `seconds` to find out, the answer is False."""
    run = found.moments if found.culprit is None else (*found.moments, found.culprit)
    try:
        with alarm(seconds):
            return is_order_of_agents(program, run, World(about.externs, nobody))
    except OutOfTime:
        return False


def _fleet(options: Namespace, checked: Checked) -> tuple[int, Mapping[str, Any]]:
    """How many robots, and the values of params that a fleet file gives."""
    if options.fleet is None:
        return options.robots or ROBOTS, {}
    targets = {name: manifest.load(name) for name in manifest.available()}
    fleet, params = read_fleet(options.fleet, targets, checked.program, options.program)
    return options.robots or len(fleet.robots), params


def _environment(options: Namespace, program: Program, robots: int) -> Environment:
    source = read_source(options.env) if options.env else None
    found: list[tuple[Source, Diagnostic]] = []

    def note(code: str, message: str, span: Span, help: str) -> None:
        assert source is not None
        found.append((source, Diagnostic(code, "error", message, span, help=help)))

    around = environment(program, robots, source, note)
    if around is None:
        raise Rejected(found)
    return around


def _status(result: Result) -> int:
    if result.violation is not None:
        return VIOLATED
    if result.stopped == "interrupted":
        return INTERRUPTED
    return INCONCLUSIVE if result.stopped else HOLDS
