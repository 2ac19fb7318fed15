"""Interface of one application of a fleet, as its proof sees it (ADR 0055).

The interface has the guarantees of the shared variables that the application declares or imports, in terms of the
application's own program, and everything that other applications may change. A proof knows no more of the others: it
knows none of their invariants.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Any, NamedTuple

from koordgen.lang.ir import decl
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.ports import clears
from koordgen.lang.ir.tree import map_children, walk
from koordgen.lang.ir.types import BOOL, INT, PerRobot, list_of
from koordgen.lang.node import replace
from koordgen.lang.semantics.composition import Application, System
from koordgen.lang.source import Span
from koordgen.verify.prove.encode.loop import written
from koordgen.verify.prove.encode.state import Key, declared

OTHERS, COMMANDS = "(other applications)", "(commands from outside)"


class GuaranteeInScope(NamedTuple):
    """Guarantee of a shared variable that an application declares or imports.

    `name`: exporting application and guarantee, "mapping.Kept".
    `key`: the variable in the application's program.
    `before`, `after`: the temps in `formula` that are the variable's values before and after a write. The formula of a
        state guarantee reads `before` only.
    `is_own`: whether the application itself declares the variable.
    `file`, `line`: where the exporter states the guarantee."""

    name: str
    key: Key
    before: str
    after: str
    formula: ir.Expr
    is_step: bool
    is_own: bool
    file: str
    line: int

    @property
    def label(self) -> str:
        return f"guarantee {self.name}"


class ImportFact(NamedTuple):
    """Formula that is true of every view of an importing program. `label`: the reason. `line`: line of the import."""

    label: str
    formula: ir.Expr
    line: int


class Interface(NamedTuple):
    """Interface of one application.

    `foreign`: the shared variables that another application may write: those exported with `write`, and all imported
        variables, whether the program writes them itself or not. `commands` belong to them.
    `commands`: the variables that take commands from another fleet, after `init`; see decl.Provides.
    `cleared`: sensors that a command of another application on the same robot may clear.
    `commanded`: ports that another application on the same robot may command.
    `pids`: the local variables `Name.pid`, which never change.
    `facts`: facts about the exporters' members, which never change.
    `sizes`: facts about the values of imported slots, true in every state."""

    guarantees: tuple[GuaranteeInScope, ...] = ()
    foreign: frozenset[Key] = frozenset()
    commands: frozenset[Key] = frozenset()
    cleared: frozenset[Key] = frozenset()
    commanded: frozenset[Key] = frozenset()
    pids: frozenset[Key] = frozenset()
    facts: tuple[ImportFact, ...] = ()
    sizes: tuple[ImportFact, ...] = ()

    @property
    def moved(self) -> frozenset[Key]:
        """Return everything of the program's state that another application may change."""
        return self.foreign | self.ports

    @property
    def ports(self) -> frozenset[Key]:
        return self.cleared | self.commanded

    def with_commands(self, program: decl.Program) -> Interface:
        """Return the interface of a program that another fleet commands, as the modules that it provides allow."""
        commands = frozenset([("cell", name) for name in decl.commanded(program)])
        return self._replace(foreign=self.foreign | commands, commands=commands) if commands else self

    @property
    def is_alone(self) -> bool:
        """Return whether the program runs alone on its fleet. Another fleet may command it."""
        return self._replace(foreign=self.foreign - self.commands, commands=frozenset()) == ALONE

    @property
    def others(self) -> str:
        """Return the name of the steps from outside the program, as obligations have it."""
        return COMMANDS if self.is_alone else OTHERS

    def of(self, keys: Collection[Key]) -> list[GuaranteeInScope]:
        """Return the guarantees of the variables `keys`."""
        return [guarantee for guarantee in self.guarantees if guarantee.key in keys]

    def without(self, names: Collection[str]) -> Interface:
        """Return the interface without the guarantees that have these labels."""
        kept = tuple([guarantee for guarantee in self.guarantees if guarantee.label not in names])
        return self if len(kept) == len(self.guarantees) else self._replace(guarantees=kept)


ALONE = Interface()


class ApplicationInScope(NamedTuple):
    """Application with its interface. `program` also has the functions and params that imported guarantees use."""

    program: decl.Program
    interface: Interface


def in_scope(system: System, index: int) -> ApplicationInScope:
    """Return an application of a system with its interface."""
    application = system.applications[index]
    program = application.program
    foreign = {("cell", export.variable) for export in program.exports if export.is_written}
    guarantees = [
        _own(application, guarantee, _key(program, export.variable))
        for export in program.exports
        for guarantee in export.guarantees
    ]
    for imported in application.program.imports:
        foreign |= {("cell", name) for name in imported.variables}
        moved = _MovedGuarantees(imported, system.applications[system.exporter(index, imported)])
        guarantees += moved.guarantees()
        program = moved.added_to(program)
    cleared, commanded = _foreign_ports(system, index)
    pids = frozenset([("local", imported.pid) for imported in program.imports])
    facts = tuple([fact for imported in program.imports for fact in _facts(imported, program)])
    sizes = tuple([fact for imported in program.imports for fact in _sizes(imported, program)])
    interface = Interface(tuple(guarantees), frozenset(foreign), frozenset(), cleared, commanded, pids, facts, sizes)
    return ApplicationInScope(program, ALONE if interface == ALONE else interface)


def _key(program: decl.Program, variable: str) -> Key:
    shared = next(v for v in program.shared if v.name == variable)
    return "slot" if shared.kind == "allread" else "cell", variable


def _own(application: Application, guarantee: decl.Guarantee, key: Key) -> GuaranteeInScope:
    name, file = f"{application.name}.{guarantee.name}", application.program.path
    g = guarantee
    return GuaranteeInScope(name, key, g.before, g.after, g.formula, decl.is_step(g), True, file, g.span.line)


def _foreign_ports(system: System, index: int) -> tuple[frozenset[Key], frozenset[Key]]:
    """Return the sensors that other applications on the same robots may clear, and the ports that they may command."""
    application = system.applications[index]
    own = {key for key in declared(application.program) if key[0] == "port"}
    cleared, commanded = set[Key](), set[Key]()
    for other in system.applications:
        if other is application or not set(other.members) & set(application.members):
            continue
        blocks = [other.program.init, *[event.effect for event in other.program.events]]
        writes = {key for block in blocks for key in written(block) if key[0] == "port"}
        by_command = clears(other.program)
        commanded |= writes & own
        cleared |= {("port", sensor) for _, name in writes for sensor in by_command.get(name, ())} & own
    return frozenset(cleared - commanded), frozenset(commanded)


# Facts about imports, true in every view by construction (`view` in koordgen/lang/semantics/system.py).


def _facts(imported: decl.Import, program: decl.Program) -> Iterator[ImportFact]:
    """Yield the facts about the exporter's members: their number, and each robot's place among them."""
    span = imported.span
    size = ir.ParamRead(imported.size, INT, span)
    label = f"members of {imported.name}"
    yield ImportFact(label, _compare("<=", _number(1, span), size), span.line)
    reads = (ir.LocalRead, ir.LocalOf)
    if not any(isinstance(node, reads) and node.name == imported.pid for node in walk(program)):
        return
    i, j = ir.TempRead("i@member", INT, span), ir.TempRead("j@member", INT, span)
    first, second = (ir.LocalOf(imported.pid, robot, INT, span) for robot in (i, j))
    inside = ir.Logic("and", _compare("<=", _number(-1, span), first), _compare("<", first, size), BOOL, span)
    yield ImportFact(label, _for_all(i, inside), span.line)
    none, other = _compare("==", first, _number(-1, span)), _compare("!=", first, second)
    apart = ir.Logic("or", _compare("==", i, j), ir.Logic("or", none, other, BOOL, span), BOOL, span)
    yield ImportFact(label, _for_all(i, _for_all(j, apart)), span.line)


def _sizes(imported: decl.Import, program: decl.Program) -> Iterator[ImportFact]:
    """Yield the facts that an imported slots list has an element for each member of the exporter."""
    types = {variable.name: variable.type for variable in program.shared}
    for name in imported.slots:
        slots = ir.SharedRead(name, types[name], imported.span)
        size = ir.ParamRead(imported.size, INT, imported.span)
        long = ir.Builtin("len", (slots,), INT, imported.span)
        yield ImportFact(f"slots of {imported.name}", _compare("==", long, size), imported.span.line)


def _number(value: int, span: Span) -> ir.Expr:
    return ir.Const(value, INT, span)


def _compare(op: str, left: ir.Expr, right: ir.Expr) -> ir.Compare:
    return ir.Compare(op, left, right, BOOL, left.span)


def _for_all(robot: ir.TempRead, body: ir.Expr) -> ir.Expr:
    return ir.Quantified("forall", robot.name, ir.Ids(list_of(INT), robot.span), body, BOOL, robot.span)


class _MovedGuarantees:
    """Guarantees of an exporter in terms of an importer's program.

    The exporter's N_SYS becomes `Name.N_SYS`, its ID the range up to it, and its params and functions get the prefix
    "Name.", since the importer may have others of the same names. A spec function that the import lists keeps its name.
    An allread variable becomes a list."""

    def __init__(self, imported: decl.Import, exporter: Application) -> None:
        self.imported, self.exporter = imported, exporter
        self.kept = frozenset(imported.specs)
        self.params: dict[str, None] = {}
        self.called: dict[str, None] = {}
        self.names_robots = False

    def guarantees(self) -> list[GuaranteeInScope]:
        """Return the guarantees of the imported variables."""
        found = []
        for export in self.exporter.program.exports:
            for guarantee in export.guarantees if export.variable in self.imported.variables else ():
                own = _own(self.exporter, guarantee, ("cell", export.variable))
                found.append(own._replace(formula=self.moved(guarantee.formula), is_own=False))
        return found

    def added_to(self, program: decl.Program) -> decl.Program:
        """Return the importer's program with the params and functions that the moved guarantees use."""
        theirs = self.exporter.program
        functions, externs = [], []
        for function in reversed(theirs.functions):  # each function stands after those that it calls
            if function.name in self.called:
                functions.append(replace(self.moved(function), name=self.name(function.name)))
        for extern in theirs.externs:
            if extern.name in self.called:
                externs.append(replace(self.moved(extern), name=self.name(extern.name)))
        specs = [replace(s, name=self.name(s.name)) for s in theirs.specs if s.name in self.called.keys() - self.kept]
        params = [replace(self.moved(p), name=self.name(p.name)) for p in theirs.params if p.name in self.params]
        if self.names_robots:
            span, type_ = self.imported.span, list_of(INT)
            params.append(decl.Param(self.name("ID"), type_, ir.Make((), type_, span), span))
        if not (functions or externs or specs or params):
            return program
        return replace(
            program,
            functions=(*program.functions, *reversed(functions)),
            externs=(*program.externs, *externs),
            specs=(*program.specs, *specs),
            params=(*program.params, *params),
        )

    def name(self, name: str) -> str:
        return name if name in self.kept else f"{self.imported.name}.{name}"

    def moved(self, node: Any) -> Any:
        """Return an expression, a function or a param of the exporter in terms of the importer's program."""
        size = ir.ParamRead(self.imported.size, INT, self.imported.span)
        match node:
            case ir.NSys() | ir.Builtin("len", (ir.Ids(),)):
                return size
            case ir.Quantified(_, _, ir.Ids(_, span)):
                robots = ir.Range(_number(0, span), size, 1, list_of(INT), span)
                return replace(node, domain=robots, body=self.moved(node.body))
            case ir.Contains(item, ir.Ids()):
                item = self.moved(item)
                inside = _compare("<=", _number(0, node.span), item), _compare("<", item, size)
                return ir.Logic("and", *inside, BOOL, node.span)
            case ir.Ids(type_, span):
                self.names_robots = True  # an arbitrary list: a guarantee that holds for each list holds for this one
                return ir.ParamRead(self.name("ID"), type_, span)
            case ir.ParamRead(name):
                self.params[name] = None
                return replace(node, name=self.name(name))
            case ir.Call(name) | ir.ExternCall(name):
                self.called[name] = None
                return map_children(replace(node, name=self.name(name)), self.moved)
            case ir.TempRead(_, PerRobot(element)):
                return replace(node, type=list_of(element))
        return map_children(node, self.moved)
