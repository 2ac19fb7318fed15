"""`koordgen explore fleet.yaml`: exploration of the applications of a fleet file."""

from __future__ import annotations

import json
import sys
import time
from argparse import Namespace
from collections.abc import Mapping
from pathlib import Path

from koordgen.build.bundle.functions import functions_file
from koordgen.build.emit.program import functions_module
from koordgen.build.emit.system import system_hash, with_sizes
from koordgen.build.pipeline import CheckedSystem, check_system
from koordgen.cli.base.alarm import alarm
from koordgen.cli.base.console import USAGE, WRONG, Failure, print_diagnostics
from koordgen.cli.base.terminal import ProgressLine, coloured_verdicts
from koordgen.cli.verify.explore import explore_program, further_bounds, progress_on, read_environment, status
from koordgen.cli.verify.prove import save
from koordgen.lang.semantics.composition import System
from koordgen.verify.explore.breadth_first import ExplorationBounds
from koordgen.verify.explore.environment import Environment, MissingEnvironment
from koordgen.verify.explore.search import DEADLOCK
from koordgen.verify.explore.show import unexplored
from koordgen.verify.explore.system.environment import SystemEnvironmentSteps, answers, system_environment
from koordgen.verify.explore.system.machine import SystemMachine
from koordgen.verify.explore.system.search import SystemResult, SystemSearch
from koordgen.verify.explore.system.show import document, itf, report
from koordgen.verify.explore.system.trace import trace
from koordgen.verify.prove.report.trace import RunOrigin
from koordgen.verify.replay.functions import CannotCall, externs

# options that do not apply to a fleet file with applications -> what takes their place
_REFUSED: Mapping[str, tuple[str, str]] = {
    "robots": ("--robots", "the fleet file names the robots of each application"),
    "fleet": ("--fleet", "leave it out: the fleet file is the argument"),
    "param": ("--param", "set params under `applications:` in the fleet file"),
    "functions": ("--functions", "put NAME_functions.py beside each program"),
}


def explore_system(options: Namespace) -> int:
    """Run `koordgen explore` for a fleet file, and return the exit status.

    One application without guarantees is explored as its program alone, with all reductions."""
    checked = check_system(options.program)
    if options.format == "text":
        once = {part.source.path: part for part in checked.parts}
        print_diagnostics([(part.source, d) for part in once.values() for d in part.diagnostics], options)
    for key, (option, help) in _REFUSED.items():
        if getattr(options, key):
            raise Failure(USAGE, f"{option} does not apply to a fleet file with applications", help)
    system, names = checked.system, [robot.name for robot in checked.fleet.robots]
    (first, *others) = checked.fleet.applications
    if not others and not any(export.guarantees for export in system.applications[0].program.exports):
        path = str(Path(options.program).parent / first.program)
        alone = Namespace(**{**vars(options), "program": path})
        return explore_program(alone, checked.parts[0].program, len(first.members), first.params)
    try:
        around = read_environment(options, lambda source, note: system_environment(system, source, note))
        result = _search(options, checked, around)
        if result.violation is None and not result.stopped:
            result = result._replace(stopped=_unexplored(system))
    except MissingEnvironment as error:
        raise Failure(USAGE, str(error), "`koordgen docs explore` explains the file for --env") from None
    if options.format == "json":
        print(json.dumps(document(result, system, names), indent=2), flush=True)
    else:
        sys.stdout.write(coloured_verdicts(report(result, system, options.program, names), sys.stdout))
        sys.stdout.flush()
    if result.violation is not None and options.trace:
        hashed, _ = hash_of_system(checked, options.program)
        save(options.trace, trace(result.violation, system, names, _origins(options.program, checked, around, hashed)))
    if result.violation is not None and options.itf:
        save(options.itf, itf(result.violation, system, names))
    return status(result.violation is not None, result.stopped)


def _unexplored(system: System) -> str:
    return unexplored(application.program for application in system.applications)


def _search(options: Namespace, checked: CheckedSystem, around: Environment) -> SystemResult:
    """Explore the system. If a violation is found, look for a run to it that agents can execute."""
    system, line = checked.system, ProgressLine(sys.stderr)
    show = progress_on(line)
    bounds = ExplorationBounds(options.rounds, options.states, options.seconds)
    try:
        machine = SystemMachine(system, answers(system, around), _functions(options.program, checked))
        steps = SystemEnvironmentSteps(machine, around)
        search = SystemSearch(
            machine, steps, bounds, time.monotonic, show, independence=options.independence,
            deadlock=options.deadlock and not _unexplored(system),
        )  # fmt: skip
        with alarm(bounds.seconds):
            result = search.run()
        found = result.violation
        if found is None:
            return result
        machine.forget_failures()
        rounds = found.run_states[-1].round
        further = further_bounds(bounds, rounds, len(system.instances()), result.progress)
        deadlock = found.name == DEADLOCK
        second = SystemSearch(machine, steps, further, time.monotonic, show, deadlock=deadlock, as_agents=True)
        with alarm(further.seconds):
            again = second.run().violation
        if again is None or (again.application, again.name) != (found.application, found.name):
            return result._replace(violation=found._replace(of_agents=False))
        longer = rounds < again.run_states[-1].round
        return result._replace(violation=again._replace(shortest=rounds if longer else None))
    except CannotCall as error:
        raise Failure(WRONG, str(error), "the file belongs beside its program") from None
    finally:
        line.end()


def _origins(fleet_path: str, checked: CheckedSystem, around: Environment, hashed: str) -> list[RunOrigin]:
    """Return for each application the hash of the system, answers of ports and extern functions."""
    given, files = answers(checked.system, around), _functions(fleet_path, checked)
    return [
        RunOrigin(hashed, answers=answer, externs=externs(application.program, file))
        for application, answer, file in zip(checked.system.applications, given, files, strict=True)
    ]


def _functions(fleet_path: str, checked: CheckedSystem) -> list[Path]:
    """Return the file with the extern functions of each application."""
    folder, system = Path(fleet_path).parent, checked.system
    return [
        (folder / settings.program).with_name(f"{functions_module(application.program)}.py")
        for settings, application in zip(checked.fleet.applications, system.applications, strict=True)
    ]


def hash_of_system(checked: CheckedSystem, fleet_path: str) -> tuple[str, list[Path | None]]:
    """Return the hash that the bundles of a fleet have, and the file of extern functions of each application."""
    programs = [application.program for application in checked.system.applications]
    files = [
        file if functions_file(program, file.parent, None) else None
        for program, file in zip(programs, _functions(fleet_path, checked), strict=True)
    ]
    return system_hash(with_sizes(checked.system), list(map(_content, files))), files


def _content(file: Path | None) -> bytes:
    return file.read_bytes() if file is not None and file.is_file() else b""
