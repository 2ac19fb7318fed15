"""`koordgen prove` for robots that are fleets themselves: their programs, and the verdicts about both levels."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, NamedTuple

from koordgen.cli.base.console import INCONCLUSIVE, SURROUNDINGS, USAGE, Failure, print_diagnostics

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Mapping

    from koordgen.build.pipeline import CheckedSystem
    from koordgen.lang.analyze.params import Value
    from koordgen.lang.ir.decl import Program
    from koordgen.lang.ir.expr import Expr
    from koordgen.verify.prove.report.levels import InnerRobots, LevelVerdicts
    from koordgen.verify.prove.smt.solve import CrossCheck, Solver


class OuterFleet(NamedTuple):
    """Parts of a fleet file that a proof reads: values of params, and the fleets that are robots.

    `inner`: the fleet of each squad, by the squad's name. `targeted`: the other robots of a fleet with squads."""

    params: Mapping[str, Value]
    inner: Mapping[str, CheckedSystem]
    targeted: tuple[str, ...]


class InnerProgram(NamedTuple):
    """Program of the fleets that are robots, with the params that are fixed. `robots`: None without a fleet file."""

    program: Program
    params: Mapping[str, Expr]
    robots: InnerRobots | None


def read_outer(options: Namespace, program: Program) -> OuterFleet:
    """Read the fleet file, if the command names one. Raises Failure, Rejected."""
    if options.fleet is None:
        return OuterFleet({}, {}, ())
    from koordgen.build.pipeline import read_levels
    from koordgen.fleet import manifest

    targets = {name: manifest.load(name) for name in manifest.available()}
    fleet, inner = read_levels(options.fleet, targets, program, options.program, squads=True)
    if inner and options.inner is not None:
        message = f"{options.fleet} names the fleets that are robots, but --inner is given as well"
        raise Failure(USAGE, message, "remove --inner")
    targeted = [robot.name for robot in fleet.robots if inner and robot.inner is None]
    named = dict(zip([squad.name for squad in fleet.squads], inner, strict=True))
    return OuterFleet(fleet.params, named, tuple(targeted))


def prove_inner(
    options: Namespace, fleet: OuterFleet, outer: Program, params: Mapping[str, Expr], solver: Solver | CrossCheck,
    seconds: float,
) -> list[LevelVerdicts]:  # fmt: skip
    """Prove of each inner program what the outer program assumes of its modules, in at most `seconds`.

    `params`: those of the outer program that are fixed. Raises Failure, Rejected."""
    from koordgen.cli.base.alarm import alarm
    from koordgen.lang.semantics.deadline import OutOfTime
    from koordgen.verify.prove.report.levels import prove_levels

    until, found = time.monotonic() + seconds, []
    for inner in [_named(options)] if options.inner is not None else _providers(options, fleet):
        try:
            with alarm(max(0.0, until - time.monotonic())):
                verdicts = prove_levels(inner.program, outer, inner.params, params, solver)
        except OutOfTime:
            message = f"the time limit of {seconds:g} s for the proof of {inner.program.path} is over"
            raise Failure(INCONCLUSIVE, message, "try a longer --timeout") from None
        found.append(verdicts._replace(robots=inner.robots))
    return found


def with_validation_of(
    options: Namespace, fleet: OuterFleet, found: list[LevelVerdicts], program_hash: str
) -> list[LevelVerdicts]:
    """Return the verdicts about both levels, with what the report of the option --validation has measured.

    `program_hash`: of the outer program. Raises Failure."""
    if options.validation is None:
        return found
    from koordgen.verify.prove.report.levels import with_validation

    report, hashes = _report(options.validation), {"": program_hash}
    hashes |= {name: _system_hash(checked) for name, checked in fleet.inner.items()}
    if report.get("hashes") != hashes:
        message = f"{options.validation} is about other programs, params or squads than these"
        raise Failure(USAGE, message, f"validate these: koordgen validate {options.program} --fleet FILE")
    return [with_validation(each, _validated(report, each)) for each in found]


def _system_hash(checked: CheckedSystem) -> str:
    """Return the hash that bundles of a fleet with applications have."""
    from pathlib import Path

    from koordgen.build.bundle.functions import functions_file
    from koordgen.build.emit.system import system_hash, with_sizes

    system, functions = with_sizes(checked.system), list[bytes]()
    for part, application in zip(checked.parts, system.applications, strict=True):
        file = functions_file(application.program, Path(part.source.path).parent, None)
        functions.append(file.read_bytes() if file and file.is_file() else b"")
    return system_hash(system, functions)


def _report(path: str) -> dict[str, Any]:
    """Read the report of a validation. Raises Failure."""
    import json

    way = "give the file validation.json that `koordgen validate` has written"
    try:
        with open(path, encoding="utf-8") as file:
            found = json.load(file)
    except OSError as error:
        raise Failure(SURROUNDINGS, f"{path}: {error.strerror or error}", way) from None
    except ValueError as error:
        raise Failure(USAGE, f"{path}: not JSON: {error}", way) from None
    if not isinstance(found, dict) or found.get("format") != "koord-validation/1":
        raise Failure(USAGE, f"{path}: not the report of a validation", way)
    return found


def _validated(report: dict[str, Any], levels: LevelVerdicts) -> dict[int, str]:
    """Return line of an assumption -> the runs in which all squads of one inner program kept it."""
    wanted = set() if levels.robots is None else set(levels.robots.names)
    found = {}
    for each in report["assumptions"]:
        seen = {robot["name"] for robot in each["robots"] if robot["windows"]}
        if each["verdict"] == "VALIDATED" and wanted and wanted <= seen:
            found[each["line"]] = (
                f"{each['runs']} simulated runs of {report['seconds']:g} s kept it: a run violates it with a "
                f"probability below {report['epsilon']:g} (confidence {1 - report['gamma']:g})"
            )
    return found


def _named(options: Namespace) -> InnerProgram:
    """Return the program of the option --inner. Raises Failure, Rejected."""
    from koordgen.build.pipeline import check_file

    checked = check_file(options.inner)
    if options.format == "text":
        print_diagnostics([(checked.source, d) for d in checked.diagnostics], options)
    if not checked.program.provides:
        message = f"{options.inner} provides no module, so its fleet cannot be a robot"
        raise Failure(USAGE, message, "declare the module's ports: 'provides Motion:' (`koordgen docs language`)")
    return InnerProgram(checked.program, {}, None)


def _providers(options: Namespace, fleet: OuterFleet) -> list[InnerProgram]:
    """Return the programs that provide the modules of squads, each once for equal params and rounds. Raises Failure."""
    from koordgen.verify.prove.report.levels import InnerRobots

    found: dict[object, InnerProgram] = {}
    for name, checked in fleet.inner.items():
        parts = zip(checked.parts, checked.fleet.applications, checked.system.applications, strict=True)
        part, settings, application = next(each for each in parts if each[2].program.provides)
        program = application.program
        if program.imports or any(export.is_written or export.guarantees for export in program.exports):
            message = f"{part.source.path} shares variables with other applications, so it is not proved alone"
            raise Failure(INCONCLUSIVE, message, "provide the modules by a program without imports and exports")
        params = {p.name: p.default for p in program.params if p.name in settings.params}
        delta, key = checked.fleet.delta, (part.source.path, repr(settings.params), checked.fleet.delta)
        if key not in found and options.format == "text":
            print_diagnostics([(part.source, d) for d in part.diagnostics], options)
        known = found.get(key)
        names = (*(known.robots.names if known and known.robots else ()), name)
        found[key] = InnerProgram(program, params, InnerRobots(names, delta))
    return list(found.values())
