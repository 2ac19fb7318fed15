"""Compiler pipeline: text -> syntax tree -> typed IR -> IR with the params of this build -> bundles."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import TYPE_CHECKING

from koordgen.lang.analyze.program import check
from koordgen.lang.diagnostics import Diagnostic, in_order, together
from koordgen.lang.ir.decl import Program
from koordgen.lang.ir.verify import verify
from koordgen.lang.node import Node, replace
from koordgen.lang.source import Source, Span
from koordgen.lang.syntax import decl as tree
from koordgen.lang.syntax.parse import parse

# `check` does not need these modules. Functions that need them import them locally, because an import of pathlib alone
# takes 10 % of the time of `check`.
if TYPE_CHECKING:
    from pathlib import Path

    from koordgen.build.bundle.plan import Files, Ingredients
    from koordgen.build.bundle.plan_system import SystemIngredients
    from koordgen.fleet.file import Fleet
    from koordgen.fleet.manifest import Target
    from koordgen.fleet.robots import FleetRobot
    from koordgen.fleet.settings import DriverClass, NameChecks, ValueCheck
    from koordgen.lang.analyze.params import Value
    from koordgen.lang.semantics.composition import Application, System


class Rejected(Exception):
    """Raised for errors in the user's files. `found`: each diagnostic with the source that its span points into."""

    def __init__(self, found: Collection[tuple[Source, Diagnostic]]) -> None:
        super().__init__("the user's files have errors")
        self.found = tuple(found)


class Checked(Node):
    """A program without errors, with the warnings and notes of its check.

    `elsewhere`: warnings and notes about other files of a build, each with its source.
    """

    source: Source
    program: Program
    diagnostics: tuple[Diagnostic, ...]
    elsewhere: tuple[tuple[Source, Diagnostic], ...] = ()


class CheckedSystem(Node):
    """The applications of a fleet file without errors: their programs, in the order of the file, and the system.

    `source`: the fleet file. The programs of `system` have the params of the fleet file; those of `parts` do not.
    """

    source: Source
    fleet: Fleet
    parts: tuple[Checked, ...]
    system: System


def read_source(path: str) -> Source:
    """Read the text of a user's file. Raises Rejected if the file cannot be read or is not UTF-8."""
    start = Span(1, 1, 1, 1)
    try:
        with open(path, "rb") as file:
            raw = file.read()
        return Source(path, raw.decode("utf-8-sig"))
    except OSError as error:
        problem = Diagnostic("F100", "error", f"the file cannot be read: {error.strerror or error}", start)
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        problem = Diagnostic(
            "F101", "error", f"byte {error.start} is not UTF-8", Span(line, 1, line, 2), help="save the file as UTF-8"
        )
    raise Rejected([(Source(path, ""), problem)])


def parse_file(path: str) -> tuple[Source, tree.Program]:
    """Read and parse a program. Raises Rejected."""
    source = read_source(path)
    parsed, found = parse(source)
    if found:
        raise Rejected([(source, d) for d in found])
    return source, parsed


def check_file(path: str) -> Checked:
    """Parse, check and verify a program that can run alone. Raises Rejected."""
    checked = check_part(path)
    unbound = check_alone(checked.program)
    if unbound:
        raise Rejected([(checked.source, d) for d in unbound])
    return checked


def check_alone(program: Program) -> list[Diagnostic]:
    """Report each import and each guarantee of a program.

    A program that runs alone has no exporter. The proof of a program alone does not know guarantees, so a program with
    guarantees is refused instead of leaving them unproved without a word.
    """
    only = "cannot be built, proved or explored alone"
    fleet = "list it under `applications:` in a fleet file, and prove the fleet with `koordgen prove fleet.yaml`"
    help = f"{fleet}; or remove the import, and declare its variables in this program"
    found = [
        Diagnostic("B011", "error", f"{i.name}: a program with imports {only}", i.span, help=help)
        for i in program.imports
    ]
    help = f"{fleet}; or remove the guarantee: if the formula holds in every state, declare it as an invariant"
    return found + [
        Diagnostic("B011", "error", f"{g.name}: a program with guarantees {only}", g.span, help=help)
        for export in program.exports
        for g in export.guarantees
    ]


def check_part(path: str) -> Checked:
    """Parse, check and verify a program, which may be one of several applications. Raises Rejected.

    After syntax errors, the sections that could be parsed are checked as well, so one run reports both kinds of errors.
    """
    source = read_source(path)
    parsed, unread = parse(source)
    program, found = check(parsed, source)
    if unread or program is None:
        raise Rejected([(source, d) for d in together(unread, found)])
    verify(program)
    return Checked(source, program, tuple(found))


def dump(path: str, after: str) -> str:
    """Return the program after a pass ("parse" or "check") as readable text. Raises Rejected."""
    if after == "parse":
        from koordgen.lang.syntax.printer import show as show_tree

        return show_tree(parse_file(path)[1])
    from koordgen.lang.ir.printer import show

    return show(check_part(path).program)


def plan_file(
    path: str,
    wanted: Collection[str] | None,
    fleet_path: str | None,
    params: Mapping[str, Value],
    functions: str | None = None,
    squads: bool = False,
) -> tuple[Checked, dict[str, Files]]:
    """Plan the bundles of one build, in memory.

    Steps: check, fleet file, params, verify, ports, sizes of datagrams, the user's Python files, plan.

    `wanted`: names of existing targets. None, which needs a fleet file, means the targets of the fleet's robots.
    `functions`: the file of the extern functions, if it is not `<app>_functions.py` beside the program.
    `squads`: see read_fleet.
    Raises Rejected, BadParam, ManifestError.
    """
    from pathlib import Path

    from koordgen.build.bundle.plan import plan, read_ingredients
    from koordgen.build.bundle.port_calls import check_calls, planner_budget
    from koordgen.build.bundle.ports import check_ports
    from koordgen.fleet import manifest
    from koordgen.lang import resources
    from koordgen.lang.analyze.params import with_params

    checked = check_file(path)
    fleet: Fleet | None = None
    inner: tuple[CheckedSystem, ...] = ()
    given = dict(params)
    if fleet_path is not None:
        targets = {name: manifest.load(name) for name in manifest.available()}
        fleet, inner = read_levels(fleet_path, targets, checked.program, path, squads)
        given = {**fleet.params, **given}
        needed = {r.target for r in fleet.robots if r.inner is None}.union(wanted or ())
    else:
        needed = set(wanted or ())
        targets = {name: manifest.load(name) for name in needed}
    used = tuple(targets[name] for name in sorted(needed))
    program = with_params(checked.program, given)
    verify(program)
    drivers = fleet.drivers if fleet else {}
    sending = _check_sending(program, fleet) if fleet else []
    wrong = [*check_ports(program, used, drivers), *(d for d in sending if d.severity == "error")]
    own, missing = _beside(program, path, fleet_path, drivers, used, functions)
    own |= _own_classes(path, fleet_path, fleet, targets) if fleet and fleet_path else {}
    if wrong or missing:
        raise Rejected([(checked.source, d) for d in (*wrong, *missing)])
    if fleet:
        budget = planner_budget(program, len(fleet.robots), fleet.delta, fleet.planner_budget)
        slow = check_calls(program, len(fleet.robots), fleet.delta, budget)
        checked = replace(checked, diagnostics=tuple(in_order([*checked.diagnostics, *sending, *slow])))
    source, package = Path(path).read_bytes(), resources.package()
    if fleet and inner:
        needed |= {robot.target for each in inner for robot in each.fleet.robots}
        used = tuple(targets[name] for name in sorted(needed))
        these = read_ingredients(program, source, used, fleet, package, own, given)
        notes, bundles = _plan_squads(these, read_source(str(fleet_path)), inner, wanted or needed)
        return replace(checked, elsewhere=tuple(notes)), bundles
    return checked, plan(read_ingredients(program, source, used, fleet, package, own, given), wanted or needed)


def _plan_squads(
    these: Ingredients, source: Source, inner: tuple[CheckedSystem, ...], wanted: Collection[str]
) -> tuple[list[tuple[Source, Diagnostic]], dict[str, Files]]:
    """Return warnings and notes about the inner fleets, and the bundles of an outer fleet with squads.

    `these`: of the outer program. `source`: the outer fleet file. `inner`: the fleet of each squad. Raises Rejected.
    """
    from koordgen.build.bundle.plan_squads import SquadIngredients, plan_squads, used_ports
    from koordgen.build.bundle.plan_system import NamesClash
    from koordgen.build.bundle.squad_budget import with_outer

    assert these.fleet is not None
    notes, squads = dict[object, tuple[Source, Diagnostic]](), []
    for squad, checked in zip(these.fleet.squads, inner, strict=True):
        assert squad.inner is not None
        provider = next(i for i, a in enumerate(checked.system.applications) if a.program.provides)
        ports = [each for _, each in used_ports(these.program, checked.system.applications[provider].program)]
        span = squad.inner.spans["inner"]
        outer = with_outer(checked.system, provider, these.program, len(these.fleet.robots), ports, span)
        found, ingredients = _system_ingredients(checked, these.targets, (source, outer))
        # several squads may have one program
        notes |= {(source.path, d.code, d.message, d.span.line, d.span.column): (source, d) for source, d in found}
        squads.append(SquadIngredients(squad, ingredients, provider))
    try:
        return list(notes.values()), plan_squads(these, squads, wanted)
    except NamesClash as clash:
        raise Rejected([_of_squad(source, these.fleet.squads[0], str(clash), "")]) from None


def _check_sending(program: Program, fleet: Fleet) -> list[Diagnostic]:
    """Check sizes of datagrams: errors if the fleet cannot send its shared variables, warnings if only in fragments."""
    from koordgen.build.bundle.budget import check_budget, check_link

    robots, to_all = len(fleet.robots), fleet.network["transport"] in ("broadcast", "multicast")
    addresses = sum([len(robot.inner.addresses) if robot.inner else 1 for robot in fleet.robots])
    return check_budget(program, robots) or check_link(program, robots, fleet.delta, fleet.link, to_all, addresses)


def _beside(
    program: Program,
    path: str,
    fleet_path: str | None,
    drivers: Mapping[str, DriverClass],
    targets: tuple[Target, ...],
    functions: str | None,
    is_named: bool = False,
) -> tuple[dict[str, Path], list[Diagnostic]]:
    """Return the user's Python files by their paths in a bundle, and diagnostics about these files.

    `is_named`: see check_functions.
    """
    from pathlib import Path

    from koordgen.build.bundle.functions import check_functions, functions_file
    from koordgen.build.emit.program import functions_module

    folder = Path(path).parent
    file = functions_file(program, folder, functions)
    wrong = check_functions(program, file, is_named)
    own = {f"{functions_module(program)}.py": file} if file else {}
    if fleet_path is not None and drivers:
        from koordgen.build.bundle.drivers import check_drivers, driver_files

        served = driver_files(drivers, program, [Path(fleet_path).parent, folder])
        wrong += check_drivers(program, drivers, served, targets)
        own |= {drivers[name].path: found for name, found in served.items()}
    return own, wrong


def _own_classes(path: str, fleet_path: str, fleet: Fleet, targets: Mapping[str, Target]) -> dict[str, Path]:
    """Return the files of the user's classes that robots' settings name, by their paths in a bundle."""
    from pathlib import Path

    from koordgen.build.bundle.drivers import find
    from koordgen.fleet.file import own_classes

    folders = [Path(fleet_path).parent, Path(path).parent]
    return {file: find(file, folders) for file in own_classes(fleet, targets)}


def read_fleet(
    path: str, targets: Mapping[str, Target], program: Program | None, program_path: str = "", squads: bool = False
) -> tuple[Fleet, dict[str, Value]]:
    """Read a fleet file. Return the fleet and its params as values. Raises Rejected, ManifestError.

    Without a `program`, params are not checked against their declarations. Classes that settings name are looked up in
    the folder of the fleet file, then in that of the program. `squads`: True if the caller can work with robots that
    are fleets themselves. Otherwise such robots are refused.
    """
    fleet, _ = read_levels(path, targets, program, program_path, squads)
    return fleet, fleet.params


def read_levels(
    path: str, targets: Mapping[str, Target], program: Program | None, program_path: str, squads: bool
) -> tuple[Fleet, tuple[CheckedSystem, ...]]:
    """Return the fleet of a fleet file, and the inner fleets of its squads in their order.

    Parameters: see read_fleet. Raises Rejected, ManifestError.
    """
    from koordgen.build.name_checks import name_checks, param_check
    from koordgen.fleet.settings import NameChecks

    source = read_source(path)
    params = {p.name: param_check(program, p.name) for p in program.params} if program is not None else None
    folders = _folders(path, program_path or path)
    known = name_checks({"": program}, folders) if program is not None else NameChecks()
    read = _read_fleet(source, targets, params, known)
    if program is not None and read.applications:
        message = f"this fleet file names the programs of its applications, but {program_path} is given as well"
        help = (
            f"give {path} in place of the program; `koordgen docs fleet#applications` lists the commands that take it"
        )
        span = read.applications[0].spans[""]
        raise Rejected([(source, Diagnostic("F005", "error", message, span, help=help))])
    if not read.squads:
        return read, ()
    if not squads:
        message = f"{read.squads[0].name} is a fleet itself, which this command does not support"
        raise Rejected([_of_squad(source, read.squads[0], message, _SUPPORT)])
    return _with_inner_fleets(read, source, None if program is None else (read_source(program_path), program))


_SUPPORT = "`koordgen docs fleet#a-fleet-as-one-robot` lists the commands that support it"


def _of_squad(source: Source, squad: FleetRobot, message: str, help: str) -> tuple[Source, Diagnostic]:
    """Return an error at the inner fleet of a robot. `source`: the outer fleet file."""
    assert squad.inner is not None
    return source, Diagnostic("F005", "error", message, squad.inner.spans["inner"], help=help)


def _with_inner_fleets(
    fleet: Fleet, source: Source, program: tuple[Source, Program] | None
) -> tuple[Fleet, tuple[CheckedSystem, ...]]:
    """Read the fleet files of all squads, and check that they fit the outer fleet and its program.

    `source`: the outer fleet file. `program`: the outer program; None if it is not known. Raises Rejected.
    """
    from pathlib import Path

    from koordgen.build.composition import ApplicationProgram
    from koordgen.build.squads import InnerLevel, check_fleets, check_provided, with_squads

    if found := list(_nested(fleet, source)):
        raise Rejected(found)
    inner, levels = [], []
    for squad in fleet.squads:
        assert squad.inner is not None
        checked = check_system(str(Path(source.path).parent / squad.inner.file), squad.name)
        parts = zip(checked.fleet.applications, checked.parts, checked.system.applications, strict=True)
        programs = tuple([ApplicationProgram(settings, part.source, a.program) for settings, part, a in parts])
        inner.append(checked)
        levels.append(InnerLevel(squad, checked.source, checked.fleet, programs))
    found = list(check_fleets(fleet, source, levels))
    if program is not None:
        found += check_provided(program[1], program[0], source, levels)
    if found:
        raise Rejected(found)
    return with_squads(fleet, levels), tuple(inner)


def _nested(fleet: Fleet, source: Source) -> Iterator[tuple[Source, Diagnostic]]:
    """Yield an error for each inner fleet that does not exist or has squads itself. Such a fleet may contain itself."""
    from pathlib import Path

    from koordgen.fleet.squads import nesting

    def read(path: str) -> Source | None:
        try:
            return read_source(path)
        except Rejected:
            return None

    for squad in fleet.squads:
        assert squad.inner is not None
        path = Path(source.path).parent / squad.inner.file
        if not path.is_file():
            message = f"there is no file {path}, which is to be the fleet of {squad.name}"
            yield _of_squad(source, squad, message, "write its path relative to the folder of this fleet file")
            continue
        chain = nesting(str(path), read, source.path)
        if chain[-1] in chain[:-1]:
            message = f"the fleet of {squad.name} contains itself: {' -> '.join(chain)}"
            yield _of_squad(source, squad, message, "name a fleet that does not contain this one")
        elif len(chain) > 2:
            message = f"the fleet of {squad.name} has a robot that is a fleet itself, {chain[2]}"
            help = f"list the robots of {chain[2]} in {squad.inner.file}: fleets within inner fleets are not supported"
            yield _of_squad(source, squad, message, help)


def _read_fleet(
    source: Source, targets: Mapping[str, Target], params: Mapping[str, ValueCheck] | None, known: NameChecks
) -> Fleet:
    """Read a fleet file. Raises Rejected."""
    from koordgen.fleet import file as fleet

    found: list[tuple[Source, Diagnostic]] = []

    def report(code: str, message: str, span: Span, help: str) -> None:
        found.append((source, Diagnostic(code, "error", message, span, help=help)))

    read = fleet.read(source, targets, params, report, known)
    if read is None:
        raise Rejected(found)
    if read.applications and read.squads:
        message = "a fleet with `applications` cannot have a robot that is a fleet itself"
        help = "give the robot a target, or remove `applications` and name a single program on the command line"
        raise Rejected([_of_squad(source, squad, message, help) for squad in read.squads])
    return read


def _folders(*paths: str) -> list[Path]:
    """Return the folders that contain these files, in the order of the files and without duplicates."""
    from pathlib import Path

    return list(dict.fromkeys(Path(path).parent for path in paths))


def check_system(fleet_path: str, squad: str = "") -> CheckedSystem:
    """Check the programs of a fleet file's `applications`, and whether they fit together.

    `squad`: name of the robot that this fleet is; "" if it is none. Raises Rejected, ManifestError.
    """
    from pathlib import Path

    from koordgen.build.bundle.ports import check_ports
    from koordgen.build.composition import ApplicationProgram, compose
    from koordgen.build.name_checks import name_checks
    from koordgen.fleet import manifest
    from koordgen.fleet.applications import named_programs

    source = read_source(fleet_path)
    folder = Path(fleet_path).parent
    checked: dict[str, Checked] = {}
    found: list[tuple[Source, Diagnostic]] = []
    named = named_programs(source)
    for program in dict.fromkeys(named.values()):
        try:
            checked[program] = check_part(str(folder / program))
        except Rejected as rejected:
            found += rejected.found
    if found:
        raise Rejected(found)
    targets = {name: manifest.load(name) for name in manifest.available()}
    by_name = {name: checked[program].program for name, program in named.items()}
    known = name_checks(by_name, _folders(fleet_path, *(str(folder / p) for p in checked)))
    fleet = _read_fleet(source, targets, None, known)
    if not fleet.applications:
        message = f"the fleet {f'of {squad}' if squad else 'file'} names no program"
        help = "list programs under `applications:`"
        help += "" if squad else ", or name a program on the command line and this file with --fleet"
        raise Rejected([(source, Diagnostic("F003", "error", message, Span(1, 1, 1, 2), help=help))])
    parts = [ApplicationProgram(a, checked[a.program].source, checked[a.program].program) for a in fleet.applications]
    for part in parts:
        used = {fleet.robots[place].target: None for place in part.settings.members}
        wrong = check_ports(part.program, [targets[name] for name in used], fleet.drivers)
        found += [(part.source, d) for d in wrong]
    system, misfits = compose(parts, source, fleet.robots, fleet.drivers)
    if system is None or found:
        raise Rejected([*found, *misfits])
    return CheckedSystem(source, fleet, tuple(checked[a.program] for a in fleet.applications), system)


def plan_fleet_file(
    fleet_path: str, wanted: Collection[str] | None
) -> tuple[list[tuple[Source, Diagnostic]], dict[str, Files]]:
    """Plan the bundles of a fleet file with `applications`, in memory. Return warnings and notes, and the bundles.

    `wanted`: names of existing targets; None: those of the fleet's robots. Raises Rejected, ManifestError.
    """
    from koordgen.build.bundle.plan_system import NamesClash, plan_system
    from koordgen.fleet import manifest

    checked = check_system(fleet_path)
    needed = {r.target for r in checked.fleet.robots}.union(wanted or ())
    notes, these = _system_ingredients(checked, tuple(manifest.load(name) for name in sorted(needed)))
    try:
        return notes, plan_system(these, wanted or needed)
    except NamesClash as clash:
        span = checked.fleet.applications[0].spans[""]
        raise Rejected([(checked.source, Diagnostic("F005", "error", str(clash), span))]) from None


def _system_ingredients(
    checked: CheckedSystem, used: tuple[Target, ...], outer: tuple[Source, System] | None = None
) -> tuple[list[tuple[Source, Diagnostic]], SystemIngredients]:
    """Return warnings and notes, and the ingredients of a fleet with `applications`.

    `used`: the targets to build for. `outer`: for the fleet of a squad, the outer fleet file, and the system with the
    application of the outer program. Raises Rejected, ManifestError.
    """
    from pathlib import Path

    from koordgen.build.bundle.plan_system import ApplicationFiles, read_system_ingredients, slow_calls
    from koordgen.build.emit.system import with_sizes
    from koordgen.fleet import manifest
    from koordgen.lang import resources

    fleet, system, fleet_path = checked.fleet, with_sizes(checked.system), checked.source.path
    targets = {name: manifest.load(name) for name in manifest.available()}
    sources = [part.source for part in checked.parts]
    if outer is None:
        notes = _check_system_sending(fleet, sources, system)
    else:
        notes = _check_system_sending(fleet, [*sources, outer[0]], with_sizes(outer[1]))
        # No warning that the record may need several datagrams (B009): it is far smaller than its bound in most rounds.
        notes = [(source, d) for source, d in notes if d.severity == "error" or source is not outer[0]]
    found = [(source, d) for source, d in notes if d.severity == "error"]
    parts = []
    for part, settings, application in zip(checked.parts, fleet.applications, system.applications, strict=True):
        own_targets = tuple(targets[name] for name in sorted({fleet.robots[r].target for r in settings.members}))
        path = part.source.path
        own, missing = _beside(
            application.program, path, fleet_path, _own_drivers(application, fleet), own_targets, None, is_named=True
        )
        own |= _own_classes(path, fleet_path, fleet, targets)
        found += [(part.source, d) for d in missing]
        files = {} if missing else {name: file.read_bytes() for name, file in own.items()}
        parts.append(ApplicationFiles(Path(path).read_bytes(), files, settings.params))
    if found:
        raise Rejected(found)
    shares = {a.name: a.share for a in fleet.applications if a.share is not None}
    these = read_system_ingredients(system, tuple(parts), used, fleet, resources.package(), shares)
    notes += [(checked.parts[index].source, d) for index, d in slow_calls(these)]
    once = {part.source.path: part for part in checked.parts}
    return [*((part.source, d) for part in once.values() for d in part.diagnostics), *notes], these


def _check_system_sending(fleet: Fleet, sources: list[Source], system: System) -> list[tuple[Source, Diagnostic]]:
    """Check sizes of messages of all applications; see _check_sending. `sources`: of the applications' programs."""
    from koordgen.build.bundle.system_budget import check_system_budget, check_system_link

    names, to_all = [robot.name for robot in fleet.robots], fleet.network["transport"] in ("broadcast", "multicast")
    found = check_system_budget(system, names) or check_system_link(system, names, fleet.delta, fleet.link, to_all)
    return [(sources[index], d) for index, d in found]


def _own_drivers(application: Application, fleet: Fleet) -> dict[str, DriverClass]:
    """Return the drivers of the modules that the program of an application has."""
    modules = {module.name for module in application.program.modules}
    return {name: driver for name, driver in fleet.drivers.items() if name in modules}


def fleet_name(fleet_path: str) -> str:
    """Return the name of a fleet for folders of results: the file's, or that of its folder for `fleet.yaml`."""
    from pathlib import Path

    path = Path(fleet_path).resolve()
    return path.parent.name or path.stem if path.stem == "fleet" else path.stem


def fleet_params(path: str | None, checked: Checked, program_path: str, squads: bool = False) -> dict[str, Value]:
    """Return the params of a fleet file; empty if `path` is None. Raises Rejected, ManifestError.

    `squads`: see read_fleet."""
    if path is None:
        return {}
    from koordgen.fleet import manifest

    targets = {name: manifest.load(name) for name in manifest.available()}
    return read_fleet(path, targets, checked.program, program_path, squads)[1]
