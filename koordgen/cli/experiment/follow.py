"""Command `koordgen sim --follow TRACE`: checks that a counterexample trace fits the programs and the fleet file.

The result is a plan, with which the simulator executes the counterexample.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from koordgen.build.emit.system import with_sizes
from koordgen.build.pipeline import check_file, check_system, read_fleet
from koordgen.cli.base.building import params, refuse_options_of_programs
from koordgen.cli.base.console import INCONCLUSIVE, USAGE, WRONG, Failure
from koordgen.cli.base.values import is_fleet
from koordgen.cli.verify.explore_system import hash_of_system
from koordgen.cli.verify.prove import hash_of
from koordgen.lang.analyze.params import BadParam, Value, as_given, with_params
from koordgen.lang.ir.decl import Program
from koordgen.lang.semantics.composition import System
from koordgen.lang.semantics.step import initial
from koordgen.runtime.trace.schema import BadTrace
from koordgen.verify.follow.exact import agree, nearest
from koordgen.verify.follow.plan import CannotExecute, ModelOnly, alone, document, make_plan
from koordgen.verify.follow.read import CounterexampleTrace, read
from koordgen.verify.replay.functions import CannotCall, externs
from koordgen.verify.replay.values import BadValue, from_trace, plain

REFUSED = ("scenario", "duration", "gui", "loss", "delay", "jitter", "duplication", "reordering")


def plan_of_trace(options: Namespace) -> tuple[dict[str, Value], dict[str, Any]]:
    """Return params and the simulator's plan for executing a counterexample trace.

    The params are those of the trace, without those that the fleet file or `--param` sets. Raises Rejected, Failure."""
    for name in REFUSED:
        if getattr(options, name) not in (None, False):
            raise Failure(
                USAGE, f"--{name} does not go with --follow",
                f"leave out --{name}, because the trace determines all events of the run",
            )  # fmt: skip
    try:
        given = read(Path(options.follow))
    except BadTrace as error:
        raise Failure(WRONG, str(error), "give a trace that `koordgen explore` or `prove` wrote with --trace") from None
    if is_fleet(options.program):
        return {}, _plan_of_fleet(options, given)
    if given.composed:
        names = ", ".join(_applications(given))
        message = f"{given.path} is the trace of a fleet file with the applications {names}"
        raise Failure(USAGE, message, f"give that fleet file in place of {options.program}, without --fleet")
    program, more = _program(options, given)
    program_hash, functions = hash_of(program, options.program, options.functions)
    help = "give the Python file of the extern functions with --functions"
    return more, _plan(alone(program, given.robots), given, program_hash, [functions], help)


def _plan(
    system: System, given: CounterexampleTrace, hashed: str, functions: Sequence[Path | None], help: str
) -> dict[str, Any]:
    """Return the simulator's plan. `functions`: the file with the extern functions of each application.

    `help`: the remedy if such a file is missing. Raises Failure."""
    try:
        programs = [application.program for application in system.applications]
        made = make_plan(system, given, [externs(p, file) for p, file in zip(programs, functions, strict=True)])
        return document(made, hashed)
    except CannotExecute as error:
        raise Failure(INCONCLUSIVE if isinstance(error, ModelOnly) else WRONG, str(error), error.help) from None
    except CannotCall as error:
        raise Failure(WRONG, str(error), help) from None


def _plan_of_fleet(options: Namespace, given: CounterexampleTrace) -> dict[str, Any]:
    """Return the simulator's plan for a fleet file with applications. Raises Rejected, Failure."""
    refuse_options_of_programs(options)
    checked = check_system(options.program)
    hashed, functions = hash_of_system(checked, options.program)
    system = with_sizes(checked.system)
    own = [application.name for application in system.applications]
    again = f"search for the counterexample again: koordgen explore {options.program} --trace {given.path}"
    if given.composed and _applications(given) != own:
        names = ", ".join(_applications(given))
        message = f"{given.path} is the trace of the applications {names}; {options.program} has {', '.join(own)}"
        raise Failure(WRONG, message, again)
    if given.program_hash != hashed:
        raise Failure(
            WRONG,
            f"{given.path} is the trace of a fleet with the hash {given.program_hash or '(none)'}; "
            f"{options.program} has the hash {hashed}: its applications, their robots, a program or its extern "
            "functions are others",
            again,
        )  # fmt: skip
    robots = [member.robot for member in given.members]
    if len(robots) != len(system.instances()) or (given.composed and robots != [i.robot for i in system.instances()]):
        raise Failure(WRONG, f"{given.path} has the records of other robots than {options.program}", again)
    return _plan(system, given, hashed, functions, "put the Python file of the extern functions beside its program")


def _applications(given: CounterexampleTrace) -> list[str]:
    """Return the names of the applications in a trace."""
    return list(dict.fromkeys([member.application for member in given.members]))


def _program(options: Namespace, given: CounterexampleTrace) -> tuple[Program, dict[str, Value]]:
    """Return the program with the params of fleet file, `--param` and trace, and the params that only the trace sets.

    Raises Rejected, and Failure if the trace does not fit the program or the fleet file."""
    from koordgen.fleet import manifest

    checked = check_file(options.program)
    targets = {name: manifest.load(name) for name in manifest.available()}
    fleet, from_file = read_fleet(options.fleet, targets, checked.program, options.program)
    if len(fleet.robots) != given.robots:
        robots = f"{given.robots} robot{'s' * (given.robots != 1)}"
        raise Failure(
            WRONG, f"{given.path} is the trace of {robots}, but {options.fleet} has {len(fleet.robots)}",
            f"give a fleet file with {robots}, or search for a counterexample with --robots {len(fleet.robots)}",
        )  # fmt: skip
    try:
        own = {**from_file, **params(options.param)}
        of_trace = _params_of_trace(checked.program, given)
        asked = {name: of_trace[name] for name in given.given}
        more = {name: value for name, value in asked.items() if name not in own}
        program = with_params(checked.program, {**more, **own})
        versions = [with_params(checked.program, values) for values in (asked, own, of_trace, {})]
    except BadParam as error:
        way = "check the params in the trace, in the fleet file and in --param"
        raise Failure(WRONG, f"{given.path}: {error}", way) from None
    for name, here in initial(program, given.robots).params.items():
        if not agree(given.params[name], plain(here)):
            raise Failure(
                WRONG,
                f"{given.path}: param {name} is {given.params[name]!r} in the trace, but {plain(here)!r} in this run",
                f"search for the counterexample again, with --fleet {options.fleet} and the --param of this run",
            )  # fmt: skip
    hashes = [hash_of(version, options.program, options.functions)[0] for version in versions]
    # A program's hash depends on the notation of its params' values, so each of the possible notations is hashed.
    if given.program_hash not in hashes:
        raise Failure(
            WRONG,
            f"{given.path} is the trace of a program with the hash {given.program_hash or '(none)'}; "
            f"{options.program} has the hash {hashes[0]}",
            "the program or its extern functions have changed: search for the counterexample again",
        )  # fmt: skip
    return program, more


def _params_of_trace(program: Program, given: CounterexampleTrace) -> dict[str, Value]:
    """Return the values of params in a trace, in the form that `--param` has. Raises Failure if they do not fit."""
    types = {p.name: p.type for p in program.params}
    if set(given.params) != set(types):
        raise Failure(
            WRONG, f"{given.path} has the params {_names(given.params)}; {program.path} has {_names(types)}",
            "the program has changed: search for the counterexample again",
        )  # fmt: skip
    try:
        values = {name: from_trace(value, types[name], nearest) for name, value in given.params.items()}
        return {name: as_given(plain(value), types[name]) for name, value in values.items()}
    except (BadValue, ValueError, TypeError) as error:
        raise Failure(WRONG, f"{given.path}: the params in the trace do not fit {program.path}: {error}") from None


def _names(params: Mapping[str, Any]) -> str:
    return ", ".join(sorted(params)) or "none"
