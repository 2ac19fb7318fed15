"""Programs of a trace: named by options or found in the run's folder, and checked by their hash."""

from __future__ import annotations

import json
from argparse import Namespace
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from koordgen.build.bundle.squad_budget import OUTER
from koordgen.cli.base.building import params
from koordgen.cli.base.console import USAGE, WRONG, Failure
from koordgen.lang.ir.decl import Program
from koordgen.lang.node import replace
from koordgen.lang.semantics.composition import Application, System

SOURCE, PARAMS = "source", "params.json"  # paths in a run's folder; koordgen/build/bundle/plan.py writes them


class TracedFleet(NamedTuple):
    """Programs that the robots of a trace ran.

    `system`: the applications; of a fleet with one program, one application on all robots.
    `functions`: the file of extern functions of each application, or None.
    `is_squad`: True if the fleet is one robot of an outer fleet. Its last application then hosts the outer program: it
        is known by its writes only."""

    system: System
    functions: tuple[Path | None, ...]
    is_squad: bool = False

    @property
    def programs(self) -> System:
        """Applications whose programs are known."""
        return replace(self.system, applications=self.system.applications[:-1]) if self.is_squad else self.system

    @property
    def is_composed(self) -> bool:
        """Return whether the fleet has several applications."""
        return len(self.system.applications) > 1


def fleet_of(options: Namespace, trace: Path, header: Mapping[str, Any]) -> TracedFleet:
    """Return the programs of the trace at `trace`, which begins with `header`. Raises Rejected, Failure."""
    program_hash = str(header.get("program_hash", ""))
    if not program_hash:
        help = "counterexamples were run when they were found; `koordgen report` shows them"
        raise Failure(WRONG, f"{trace} is a counterexample, not the trace of a run", help)
    n_sys = len(header["robots"]) if "robots" in header else int(header["n_sys"])
    if options.fleet is not None and _names_programs(options.fleet):
        found = _of_fleet_file(options, header)
    elif len(header.get("applications", ())) > 1 or "composition" in header:
        found = _of_run(options, trace, header, n_sys)
    else:
        return _with_one_program(options, trace, program_hash, n_sys)
    from koordgen.build.emit.system import system_hash

    its = system_hash(found.system, [_content(file) for file in found.functions])
    is_squad = [*header.get("applications", ())][len(found.system.applications) :] == [OUTER]
    if is_squad and "robots" not in header:
        its = _with_outer_hash(options, trace, its)
    if its != program_hash:
        what = options.fleet or f"the programs in the folder {SOURCE}/ beside it"
        raise Failure(
            WRONG, f"{trace} is the trace of programs with the hash {program_hash}, but {what} has {its}",
            "fleet file, programs, params or extern functions have changed: name those of the run with --fleet",
        )  # fmt: skip
    return _hosted(found, trace, header) if is_squad else found


def _with_outer_hash(options: Namespace, trace: Path, inner: str) -> str:
    """Return the hash in the trace of one robot of a squad, which covers the outer program. Raises Failure.

    `inner`: hash of the inner programs."""
    from koordgen.runtime.trace.schema import BadTrace
    from koordgen.verify.replay.hosted import joined_hash
    from koordgen.verify.replay.trace import header_of

    if options.program is not None:
        return joined_hash(inner, _one_program(options, trace)[1])
    for folder in _folders(trace):
        with suppress(BadTrace, OSError):
            header = header_of(folder / "trace.jsonl") or {}
            if trace.parent.name.partition(".")[0] in [robot.get("name") for robot in header.get("robots", ())]:
                return joined_hash(inner, str(header.get("program_hash", "")))
    raise Failure(
        USAGE, f"{trace} is the trace of a robot of a squad, and there is no trace of the outer fleet beside it",
        "name the outer program with --program, and its params with --param",
    )  # fmt: skip


def _hosted(found: TracedFleet, trace: Path, header: Mapping[str, Any]) -> TracedFleet:
    """Return the programs of a squad with the application that hosts the outer robot. Raises Failure."""
    from koordgen.verify.replay.hosted import hosting

    part = next((p for p in header.get("composition", ()) if p["name"] == OUTER), None)
    try:
        system = hosting(found.system, None if part is None else part["variables"])
    except (LookupError, TypeError, ValueError, StopIteration) as error:
        help = "name the fleet file of the squad with --fleet"
        raise Failure(WRONG, f"{trace}: the header does not fit the programs of a squad: {error}", help) from None
    return TracedFleet(system, (*found.functions, None), is_squad=True)


def _is_squad(header: Mapping[str, Any]) -> bool:
    return [*header.get("applications", ())][-1:] == [OUTER]


def _names_programs(fleet: str) -> bool:
    from koordgen.build.pipeline import read_source
    from koordgen.fleet.applications import named_programs

    return bool(named_programs(read_source(fleet)))


def _content(file: Path | None) -> bytes:
    return file.read_bytes() if file is not None and file.is_file() else b""


def _only_for_one_program(options: Namespace, header: Mapping[str, Any]) -> None:
    """Refuse options that name parts of a single program. Raises Failure.

    In the trace of a robot of a squad, they are about the outer program."""
    if "robots" not in header and _is_squad(header):
        return
    for option, is_given in {
        "--program": options.program is not None,
        "--param": bool(options.param),
        "--functions": options.functions is not None,
    }.items():
        if is_given:
            help = "name the fleet file of the run with --fleet: it names the programs and their params"
            raise Failure(USAGE, f"{option} is for a fleet with one program, and this trace has several", help)


def _of_fleet_file(options: Namespace, header: Mapping[str, Any]) -> TracedFleet:
    from koordgen.build.bundle.functions import functions_file
    from koordgen.build.emit.system import with_sizes
    from koordgen.build.pipeline import check_system

    _only_for_one_program(options, header)
    checked = check_system(options.fleet)
    system = with_sizes(checked.system)
    parts = zip(system.applications, checked.parts, strict=True)
    files = [functions_file(a.program, Path(part.source.path).parent, None) for a, part in parts]
    return TracedFleet(system, tuple(files))


def _of_run(options: Namespace, trace: Path, header: Mapping[str, Any], n_sys: int) -> TracedFleet:
    """Return the programs in the folder of a run, connected as the header says."""
    from koordgen.build.bundle.functions import functions_file
    from koordgen.build.emit.system import with_sizes

    _only_for_one_program(options, header)
    folder = next((f for f in _folders_of_fleet(trace) if any((f / SOURCE).glob("*/*.koord"))), None)
    composition = None if folder is None else header.get("composition") or _composition_of(folder, header)
    if folder is None or composition is None:
        alone = f"{trace} is the trace of one robot"
        what = alone if folder is not None else f"there is no folder {SOURCE}/ beside {trace}"
        raise Failure(USAGE, f"{what}, and the fleet has several applications", "name the fleet file with --fleet")
    try:
        own = [part for part in composition if part["name"] != OUTER or (folder / SOURCE / OUTER).is_dir()]
        applications = tuple([_application(folder, part) for part in own])
        system = with_sizes(System(applications, n_sys))
    except (LookupError, TypeError, ValueError, StopIteration) as error:
        raise Failure(WRONG, f"{trace}: a broken header: {error!r}", "name the fleet file with --fleet") from None
    files = [functions_file(a.program, folder / SOURCE / a.name, None) for a in applications]
    return TracedFleet(system, tuple(files))


def _composition_of(folder: Path, header: Mapping[str, Any]) -> Any:
    """Return the composition in the merged trace of a run, for a robot's own trace in the run's folder, or None."""
    from koordgen.runtime.trace.schema import BadTrace
    from koordgen.verify.replay.trace import header_of

    try:
        merged = header_of(folder / "trace.jsonl") or {}
    except (BadTrace, OSError):
        return None
    if not _is_squad(header) and merged.get("program_hash") != header.get("program_hash"):
        return None
    return merged.get("composition")


def _application(folder: Path, part: Mapping[str, Any]) -> Application:
    name = Path(str(part["name"])).name  # so that no header leads out of the run's folder
    own = folder / SOURCE / name
    programs = sorted(own.glob("*.koord"))
    if len(programs) != 1:
        raise Failure(USAGE, f"{own} does not contain one program", "name the fleet file of the run with --fleet")
    program = _with_params(programs[0], _params_in(own))
    return Application(name, program, tuple([int(member) for member in part["members"]]), _bindings(program, part))


def _bindings(program: Program, part: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    """Return the bindings of a program's imports: the header names each variable with its application."""
    stored = part["variables"]
    return tuple([(i.name, str(stored[i.variables[0]]).partition(".")[0]) for i in program.imports if i.variables])


def _with_params(place: Path, given: Mapping[str, Any]) -> Program:
    from koordgen.build.pipeline import check_part
    from koordgen.lang.analyze.params import BadParam, with_params

    try:
        return with_params(check_part(str(place)).program, given)
    except BadParam as error:
        raise Failure(USAGE, str(error)) from None


def _with_one_program(options: Namespace, trace: Path, program_hash: str, n_sys: int) -> TracedFleet:
    found, its = _one_program(options, trace, options.fleet)
    if its != program_hash:
        raise Failure(
            WRONG, f"{trace} is the trace of a program with the hash {program_hash}, but {found.place} has {its}",
            "program, params or extern functions have changed: name those of the run with --program, --fleet, "
            "--param and --functions",
        )  # fmt: skip
    return TracedFleet(System.alone(found.program, n_sys), (found.functions,))


class _FoundProgram(NamedTuple):
    place: Path
    program: Program
    functions: Path | None


def _one_program(options: Namespace, trace: Path, fleet: str | None = None) -> tuple[_FoundProgram, str]:
    """Return the program that the options or the run's folder name, and its hash.

    `fleet`: fleet file with params of the program. Raises Rejected, Failure."""
    from koordgen.build.bundle.functions import functions_file
    from koordgen.build.emit.program import program_hash as hashed
    from koordgen.build.pipeline import check_file, fleet_params
    from koordgen.lang.analyze.params import BadParam, with_params
    from koordgen.lang.ir.verify import verify

    place, beside = _place(options, trace)
    checked = check_file(str(place))
    try:
        given = {**fleet_params(fleet, checked, str(place), squads=True), **beside, **params(options.param)}
        program = with_params(checked.program, given)
    except BadParam as error:
        raise Failure(USAGE, str(error)) from None
    verify(program)
    functions = functions_file(program, place.parent, options.functions)
    return _FoundProgram(place, program, functions), hashed(program, _content(functions))


def _folders(trace: Path) -> Sequence[Path]:
    """Return the folders that may be the run's folder: the trace's own folder, or one of two folders above it."""
    return (trace.parent, *trace.absolute().parents[1:3])


def _folders_of_fleet(trace: Path) -> Sequence[Path]:
    """Return the folders that may be the run's folder. The traces of a squad's robots are in the outer fleet's folder:
    those of `alpha` in folders with the names `alpha.ROBOT`."""
    folders, squad = _folders(trace), trace.absolute().parent.name.partition(".")[0]
    return (*folders, *(folder / squad for folder in folders))


def _place(options: Namespace, trace: Path) -> tuple[Path, dict[str, Any]]:
    """Return the program's path, and values of its params. Without --program, both are those in the run's folder."""
    if options.program is not None:
        return Path(options.program), {}
    for folder in _folders(trace):
        programs = sorted((folder / SOURCE).glob("*.koord"))
        if len(programs) == 1:
            return programs[0], _params_in(folder / SOURCE)
    raise Failure(USAGE, f"there is no folder {SOURCE}/ beside {trace}", "name the program with --program")


def _params_in(folder: Path) -> dict[str, Any]:
    path = folder / PARAMS
    try:
        return dict(json.loads(path.read_bytes())) if path.is_file() else {}
    except ValueError as error:
        raise Failure(WRONG, f"{path}: {error}") from None
