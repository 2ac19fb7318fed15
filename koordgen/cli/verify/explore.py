"""`koordgen explore`: options, output and exit status."""

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
from koordgen.fleet.yaml_reader import Report
from koordgen.lang.analyze.params import BadParam, with_params
from koordgen.lang.diagnostics import Diagnostic
from koordgen.lang.ir.decl import Program
from koordgen.lang.semantics.deadline import OutOfTime
from koordgen.lang.semantics.relations import is_order_of_agents
from koordgen.lang.semantics.state import World, nobody
from koordgen.lang.source import Source, Span
from koordgen.verify.explore.breadth_first import ExplorationBounds, ExplorationProgress
from koordgen.verify.explore.environment import Environment, EnvironmentSteps, MissingEnvironment, possible_answers
from koordgen.verify.explore.environment_file import environment
from koordgen.verify.explore.machine import Machine
from koordgen.verify.explore.search import DEADLOCK, ExplorationResult, FoundViolation, Search
from koordgen.verify.explore.show import document, itf, progress_text, report, trace, unexplored
from koordgen.verify.prove.report.trace import RunOrigin
from koordgen.verify.replay.functions import CannotCall, externs

ROBOTS = 3  # number of robots if neither --robots nor a fleet file names a number
MORE = 10_000  # smallest limit of states in the second search, which looks for a run that agents can execute


def explore(options: Namespace) -> int:
    """Run `koordgen explore`, and return the exit status."""
    checked = check_file(options.program)
    if options.format == "text":
        print_diagnostics([(checked.source, d) for d in checked.diagnostics], options)
    return explore_program(options, checked.program, *_fleet(options, checked))


def explore_program(options: Namespace, checked: Program, robots: int, from_fleet: Mapping[str, Any]) -> int:
    """Explore the program `options.program` on a fleet, print the result, and return the exit status.

    `from_fleet`: the params in the fleet file."""
    try:
        around = read_environment(options, lambda source, note: environment(checked, robots, source, note))
        given = {**from_fleet, **around.params, **params(options.param)}
        program = with_params(checked, given)
        result = _search(options, program, robots, around, lambda: _origin(options, program, robots, around, given))
        if result.violation is None and not result.stopped:
            result = result._replace(stopped=unexplored([program]))
    except BadParam as error:
        raise Failure(USAGE, str(error)) from None
    except MissingEnvironment as error:
        raise Failure(USAGE, str(error), "`koordgen docs explore` explains the file for --env") from None
    if options.format == "json":
        print(json.dumps(document(result, program, robots), indent=2), flush=True)
    else:
        sys.stdout.write(coloured_verdicts(report(result, program, options.program, robots), sys.stdout))
        sys.stdout.flush()
    # the result is already printed, so a failed write of a file does not lose the result of a long search
    if result.violation is not None:
        if options.trace:
            about = _origin(options, program, robots, around, given)
            save(options.trace, trace(result.violation, program, about))
        if options.itf:
            save(options.itf, itf(result.violation, program))
    return status(result.violation is not None, result.stopped)


def _origin(options: Namespace, program: Program, robots: int, around: Environment, given: Iterable[str]) -> RunOrigin:
    """Return the origin of a found run: program hash, params, and answers of ports and extern functions."""
    hashed, functions = hash_of(program, options.program, options.functions)
    return RunOrigin(hashed, tuple(given), possible_answers(around, program, robots), externs(program, functions))


def _search(
    options: Namespace, program: Program, robots: int, around: Environment, about: Callable[[], RunOrigin]
) -> ExplorationResult:
    line = ProgressLine(sys.stderr)
    show = progress_on(line)
    functions = options.functions or Path(options.program).with_name(f"{functions_module(program)}.py")
    bounds = ExplorationBounds(options.rounds, options.states, options.seconds)
    started = time.monotonic()

    def left() -> float | None:
        return None if options.seconds is None else max(0.0, options.seconds - (time.monotonic() - started))

    try:
        machine = Machine(program, robots, possible_answers(around, program, robots), Path(functions))
        surroundings = EnvironmentSteps(machine, around)
        deadlock = options.deadlock and not unexplored([program])  # a fleet that waits for a command is in no deadlock
        search = Search(
            machine, surroundings, bounds, time.monotonic, show,
            symmetry=options.symmetry, independence=options.independence, deadlock=deadlock,
            forgetting=options.forgetting,
        )  # fmt: skip
        with alarm(bounds.seconds):
            result = search.run()
        found = result.violation
        if found is None or _of_agents(found, program, about(), left()):
            return result
        found = found._replace(of_agents=False)
        machine.discards.clear()
        further = further_bounds(bounds, found.run_states[-1].round, robots, result.progress)
        second = Search(
            machine, surroundings, further, time.monotonic, show, deadlock=found.name == DEADLOCK, as_agents=True,
        )  # fmt: skip
        with alarm(further.seconds):
            again = second.run().violation
        if again is None or again.name != found.name or not _of_agents(again, program, about(), left()):
            return result._replace(violation=found)
        rounds = found.run_states[-1].round
        more = rounds < again.run_states[-1].round
        return result._replace(violation=again._replace(shortest=rounds if more else None))
    except CannotCall as error:
        raise Failure(WRONG, str(error), "name the file of the extern functions with --functions") from None
    finally:
        line.end()


def progress_on(line: ProgressLine) -> Callable[[ExplorationProgress], None]:
    """Return the function that shows the progress of an exploration on a line of the terminal."""

    def show(progress: ExplorationProgress) -> None:
        rate = progress.states / max(progress.seconds, 1e-9)
        line.show(f"depth {progress.depth}: {progress_text(progress)}, {rate:,.0f} states/s")

    return show


def further_bounds(
    bounds: ExplorationBounds, rounds: int, units: int, progress: ExplorationProgress
) -> ExplorationBounds:
    """Return the limits of the second search, which looks for a run that agents can execute.

    Agents commit only one transaction for each lock in a round. For one round of the language they may therefore need
    as many rounds as there are robots, or instances of applications: `units`. `rounds`: length of the run found first.
    """
    states = max(MORE, progress.states)
    seconds = None if bounds.seconds is None else max(0.0, bounds.seconds - progress.seconds)
    return ExplorationBounds(rounds * units, min(states, bounds.states or states), seconds)


def _of_agents(found: FoundViolation, program: Program, about: RunOrigin, seconds: float | None) -> bool:
    """Return whether agents can execute every round of the run that ends in the violation.

    If the violation is an event without a result, the run includes this event.

    Also returns False if the check takes more than `seconds`."""
    run = found.run_states if found.culprit is None else (*found.run_states, found.culprit)
    try:
        with alarm(seconds):
            return is_order_of_agents(program, run, World(about.externs, nobody))
    except OutOfTime:
        return False


def _fleet(options: Namespace, checked: Checked) -> tuple[int, Mapping[str, Any]]:
    """Return the number of robots from the options or the fleet file, and the params in the fleet file."""
    if options.fleet is None:
        return options.robots or ROBOTS, {}
    targets = {name: manifest.load(name) for name in manifest.available()}
    fleet, params = read_fleet(options.fleet, targets, checked.program, options.program)
    return options.robots or len(fleet.robots), params


def read_environment(options: Namespace, read: Callable[[Source | None, Report], Environment | None]) -> Environment:
    """Return the environment in the file that the options name. Raises Rejected, MissingEnvironment.

    `read`: function that reads the file and reports mistakes in it."""
    source = read_source(options.env) if options.env else None
    found: list[tuple[Source, Diagnostic]] = []

    def note(code: str, message: str, span: Span, help: str) -> None:
        assert source is not None
        found.append((source, Diagnostic(code, "error", message, span, help=help)))

    around = read(source, note)
    if around is None:
        raise Rejected(found)
    return around


def status(violated: bool, stopped: str) -> int:
    """Return the exit status of an exploration. `stopped`: the reason why it ended early, or empty."""
    if violated:
        return VIOLATED
    if stopped == "interrupted":
        return INTERRUPTED
    return INCONCLUSIVE if stopped else HOLDS
