"""Composition of the programs of a fleet file's `applications`, and the checks of their interfaces.

Each error points into the file that the user should change, and names the other program's file and line.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from koordgen.fleet.applications import ApplicationSettings
from koordgen.fleet.robots import FleetRobot
from koordgen.lang.analyze.params import BadParam, with_params
from koordgen.lang.diagnostics import Diagnostic
from koordgen.lang.ir.decl import Import, Module, Parameter, Program, Shared
from koordgen.lang.ir.printer import capacities
from koordgen.lang.ir.types import MapOf, RecordType, TupleOf, Type
from koordgen.lang.ir.types import Sequence as SequenceType
from koordgen.lang.ir.verify import verify
from koordgen.lang.node import Node
from koordgen.lang.semantics.composition import Application, System
from koordgen.lang.source import Source, Span

Found = Iterator[tuple[Source, Diagnostic]]


class ApplicationProgram(Node):
    """Application of a fleet file, with its program and the source of the program."""

    settings: ApplicationSettings
    source: Source
    program: Program


def compose(
    parts: Sequence[ApplicationProgram], fleet: Source, robots: Sequence[FleetRobot], driven: Mapping[str, object]
) -> tuple[System | None, list[tuple[Source, Diagnostic]]]:
    """Return the system of these applications; None, with its errors, if they do not fit together.

    `fleet`: source of the fleet file. `driven`: the modules that have drivers.
    """
    by_name = {part.settings.name: part for part in parts}
    found = [error for part in parts for error in _bindings(part, by_name, fleet)]
    found += [error for part in parts for error in _params(part, fleet)]
    if not found:
        found += _cycles(parts, fleet)
        for part in parts:
            for imported in part.program.imports:
                exporter = by_name[dict(part.settings.imports)[imported.name]]
                found += [(part.source, error) for error in _interface(part, imported, exporter)]
    found += [error for place, robot in enumerate(robots) for error in _ports(parts, place, robot.name, driven)]
    if found:
        return None, _once(found)
    applications = [
        Application(p.settings.name, _with_params(p), p.settings.members, p.settings.imports) for p in parts
    ]
    return System(tuple(applications), len(robots)), []


def _once(found: Sequence[tuple[Source, Diagnostic]]) -> list[tuple[Source, Diagnostic]]:
    """Return the errors, each place and code once. Several robots may have the same error."""
    once = {(source.path, d.span.line, d.span.column, d.code): (source, d) for source, d in reversed(found)}
    return list(reversed(once.values()))


def _with_params(part: ApplicationProgram) -> Program:
    program = with_params(part.program, part.settings.params) if part.settings.params else part.program
    verify(program)
    return program


def _bindings(part: ApplicationProgram, by_name: Mapping[str, ApplicationProgram], fleet: Source) -> Found:
    """Check that the fleet file binds each import of a program to an application, and binds no other name."""
    settings, imports = part.settings, {imported.name: imported for imported in part.program.imports}
    for name, application in settings.imports:
        span = settings.spans[f"import.{name}"]
        if name not in imports:
            known = ", ".join(imports) or "none"
            message = f"{settings.program} imports nothing under the name {name}"
            yield fleet, Diagnostic("F002", "error", message, span, help=f"its imports: {known}")
        elif application not in by_name:
            message = f"{name} is bound to {application!r}, which is no application of the fleet"
            help = f"applications: {', '.join(filter(None, by_name))}"
            yield fleet, Diagnostic("F005", "error", message, span, help=help)
    for name in imports.keys() - dict(settings.imports).keys():
        message = f"the import {name} of {_place(part.source, imports[name].span)} is bound to no application"
        help = f"write `import: {{{name}: APPLICATION}}` in the entry of {settings.name}"
        yield fleet, Diagnostic("F003", "error", message, settings.spans["name"], help=help)


def _params(part: ApplicationProgram, fleet: Source) -> Found:
    """Check each param of an application against its declaration, then all of them together."""
    sizes, is_right = {imported.size for imported in part.program.imports}, True
    for name, value in part.settings.params.items():
        span = part.settings.spans[f"params.{name}"]
        if name in sizes:
            message = f"{name} is the number of robots that run an application; it cannot be set"
            yield fleet, Diagnostic("F005", "error", message, span, help="remove it from `params`")
            is_right = False
            continue
        try:
            with_params(part.program, {name: value})
        except BadParam as error:
            yield fleet, Diagnostic("F004", "error", str(error), span)
            is_right = False
    if not is_right:
        return
    try:  # two values may be right alone and wrong together, such as the size and the resolution of a map
        _with_params(part)
    except BadParam as error:
        yield fleet, Diagnostic("F005", "error", str(error), part.settings.spans["params"])


def _cycles(parts: Sequence[ApplicationProgram], fleet: Source) -> Found:
    """Report each cycle of imports once, at one of its bindings."""
    bound = {part.settings.name: part.settings for part in parts}
    done = set[str]()

    def walk(name: str, path: list[str]) -> Found:
        for imported, other in bound[name].imports:
            if other in path:
                cycle = " -> ".join([*path[path.index(other) :], other])
                message = f"applications import from one another in a cycle: {cycle}"
                span = bound[name].spans[f"import.{imported}"]
                help = "move the variables of one direction into the other program"
                yield fleet, Diagnostic("F005", "error", message, span, help=help)
            elif other not in done:
                yield from walk(other, [*path, other])
        done.add(name)

    for name in bound:
        if name not in done:
            yield from walk(name, [name])


def _interface(part: ApplicationProgram, imported: Import, exporter: ApplicationProgram) -> Iterator[Diagnostic]:
    """Compare what a program imports with what the other one exports: variables, access, spec functions."""
    exports = {export.variable: export for export in exporter.program.exports}
    mine = {shared.name: shared for shared in part.program.shared}
    theirs = {shared.name: shared for shared in exporter.program.shared}
    file, name = exporter.source.path, exporter.settings.name
    for variable in imported.variables:
        declared, there = mine[variable], theirs.get(variable)
        export = exports.get(variable)
        if export is None or there is None:
            message = f"{name} exports no variable {variable}"
            known = f"{file} exports: {', '.join(exports) or 'nothing'}"
            if there is not None:
                known = f"write it under `export:` in {file}; its declaration is {_place(exporter.source, there.span)}"
            yield Diagnostic("B012", "error", message, declared.span, help=known)
            continue
        if difference := _difference(declared, variable in imported.slots, there):
            message = f"{variable} is not imported as {name} exports it ({_place(exporter.source, export.span)})"
            yield Diagnostic("B012", "error", f"{message}: {difference}", declared.span, help=_as(there, imported))
        if variable in imported.written and not export.is_written:
            message = f"{name} exports {variable} for reading only ({_place(exporter.source, export.span)})"
            help = f"remove `write` here, or write `write` before {variable} under `export:` in {file}"
            yield Diagnostic("B012", "error", message, declared.span, help=help)
    specs = {spec.name: spec for spec in exporter.program.specs}
    for spec in part.program.specs:
        if spec.name not in imported.specs:
            continue
        there_spec = specs.get(spec.name)
        if there_spec is None:
            message = f"{name} has no spec function {spec.name}"
            help = f"{file} has: {', '.join(specs) or 'none'}"
            yield Diagnostic("B012", "error", message, spec.span, help=help)
        elif _signature(spec.parameters, spec.result) != _signature(there_spec.parameters, there_spec.result):
            place = _place(exporter.source, there_spec.span)
            message = f"the spec function {spec.name} has other parameters or another result in {name} ({place})"
            yield Diagnostic("B012", "error", message, spec.span, help="declare it with the same parameters and result")


def _signature(parameters: Sequence[Parameter], result: Type) -> tuple[object, ...]:
    return (*(parameter.type for parameter in parameters), result)


def _difference(mine: Shared, is_list: bool, theirs: Shared) -> str:
    """Return how an import differs from the exported variable, or ""."""
    if is_list != (theirs.kind == "allread"):
        return "the exported variable is allread" if not is_list else "the exported variable is allwrite"
    type_ = mine.type.element if is_list and isinstance(mine.type, SequenceType) else mine.type
    return _type_difference(type_, theirs.type)


def _type_difference(mine: Type, theirs: Type) -> str:
    """Return a text on how two types differ, or "". `==` of types cannot be used: it ignores capacities."""
    if str(mine) != str(theirs):
        return f"the exported type is {theirs}, the imported one {mine}"
    here, there = list(capacities(mine)), list(capacities(theirs))
    if here != there:
        return f"the exported capacity is {', '.join(map(str, there))}, the imported one {', '.join(map(str, here))}"
    match mine, theirs:
        case (SequenceType(_, a), SequenceType(_, b)) | (MapOf(_, a), MapOf(_, b)):
            return _type_difference(a, b)
        case TupleOf(a), TupleOf(b):
            return next(filter(None, map(_type_difference, a, b)), "")
        case RecordType(), RecordType():
            return _record_difference(mine, theirs)
        case _:
            return ""


def _record_difference(mine: RecordType, theirs: RecordType) -> str:
    here, there = dict(mine.fields), dict(theirs.fields)
    if list(here) != list(there):
        return f"the exported record {mine.name} has the fields {', '.join(there)}, the imported one {', '.join(here)}"
    for name in here:
        if difference := _type_difference(here[name], there[name]):
            return f"in the field {name} of the record {mine.name}, {difference}"
    return ""


def _as(theirs: Shared, imported: Import) -> str:
    """Return the help that shows how to import a variable."""
    sizes = list(capacities(theirs.type))
    most = f" max {', '.join(map(str, sizes))}" if sizes else ""
    size = f"[{imported.size}]" if theirs.kind == "allread" else ""
    return f"write `{theirs.type} {theirs.name}{size}{most}`"


def _ports(parts: Sequence[ApplicationProgram], place: int, robot: str, driven: Mapping[str, object]) -> Found:
    """Check the modules that several applications use on one robot.

    All modules of a target belong to the robot's one body; each module with a driver is a body of its own. One
    application at most has actuators or callable ports of a body. All declare a port with equal type and meaning.
    """
    owners: dict[str, tuple[ApplicationProgram, Module]] = {}
    ports: dict[str, tuple[ApplicationProgram, object]] = {}
    for part in parts:
        if place not in part.settings.members:
            continue
        for module in part.program.modules:
            body = module.name if module.name in driven else ""
            if any(port.direction == "actuator" for port in module.ports):
                owner, first = owners.setdefault(body, (part, module))
                if owner is not part:
                    message = f"{part.settings.name} and {owner.settings.name} both have actuators of {robot}"
                    message += f": {first.name} at {_place(owner.source, first.span)}"
                    help = "one application moves a robot: declare only sensors here, or give it other robots"
                    yield part.source, Diagnostic("B013", "error", message, module.span, help=help)
            for port in module.ports:
                name = f"{module.name}.{port.name}"
                form = (port.type, port.direction, port.meaning)
                other, there = ports.setdefault(name, (part, form))
                if there != form and port.direction == "sensor":
                    message = f"{name} is declared in another way in {other.source.path}, for the same robot {robot}"
                    help = "declare the port with the same type and meaning in both programs"
                    yield part.source, Diagnostic("B013", "error", message, port.span, help=help)


def _place(source: Source, span: Span) -> str:
    return f"{source.path}:{span.line}"
