"""Joint assumptions of a fleet: what several applications assume about the same sensors must hold together (A).

This is the only question that is asked of the composition: two programs may each be consistent and contradict one
another. It is asked only of applications that mention the same sensor of a robot, or of the same spec function,
because formulas about different things never contradict one another. Params, functions and variables belong to one
application, so their names get the application's name as a prefix here.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Any, NamedTuple

from koordgen.lang.ir import decl
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.tree import children, map_children, walk
from koordgen.lang.ir.types import BOOL, INT, list_of
from koordgen.lang.node import replace
from koordgen.lang.semantics.composition import System
from koordgen.lang.source import Span
from koordgen.verify.prove.encode.loop import conjuncts
from koordgen.verify.prove.obligations.generate import CONSISTENT, consistent
from koordgen.verify.prove.obligations.part_encoder import ProofProblem
from koordgen.verify.prove.smt import term as t
from koordgen.verify.prove.smt.obligation import LabelledFormula, Obligation

# Application number i gets i * LINES added to the lines of its program, so a fact's line shows from which application
# the fact comes.
LINES = 10_000_000


def joint_obligations(system: System) -> Iterator[list[Obligation]]:
    """Yield the obligations that the assumptions of several applications hold together, in groups.

    Each obligation is about one robot. Facts about other robots are left out, unless a formula names them."""
    for group in connected(system):
        for robot in representatives(system, group):
            program = merged(system, group, robot)
            problem = ProofProblem(program, system.robots, {}, "little")
            problem.unrolled = False
            for name in CONSISTENT:
                t.forget()
                t.count_anew()
                try:
                    found = consistent(problem, name, robot=robot)
                except t.EncodingTooLarge as error:
                    found = _too_large(program, system.robots, str(error))
                yield [_located(system, group, replace(found, name=f"together-{name}-{robot}"))]


def representatives(system: System, group: JointGroup) -> list[int]:
    """Return robots that stand for all robots on which applications of a group meet.

    Robots with the same applications are alike, unless an assumption depends on pids."""
    are_alike = not any(_depends_on_pid(formula, frozenset()) for _, formula in group.formulas)
    found: dict[object, int] = {}
    for robot in range(system.robots):
        running = tuple([index for index in group.applications if robot in system.applications[index].members])
        if len(running) > 1:
            found.setdefault(running if are_alike else robot, robot)
    return list(found.values()) or [system.applications[group.applications[0]].members[0]]


def _depends_on_pid(node: Any, robots: frozenset[str]) -> bool:
    """Return whether the truth of a formula for a robot depends on the robot's pid.

    `robots`: variables that denote robots; as the index of a robot's variable they are no pid."""
    match node:
        case ir.Pid():
            return True
        case ir.TempRead(name):
            return name in robots
        case ir.Compare("==" | "!=", ir.TempRead(first), ir.TempRead(second)) if {first, second} <= robots:
            return False
        case ir.PortOf(_, _, ir.TempRead(name)) | ir.LocalOf(_, ir.TempRead(name)) | ir.SlotRead(_, ir.TempRead(name)):
            return name not in robots
        case ir.PortOf() | ir.LocalOf() | ir.SlotRead():
            return True
        case ir.Quantified(_, name, ir.Ids(), body):
            return _depends_on_pid(body, robots | {name})
    return any(_depends_on_pid(child, robots) for child in children(node))


def _too_large(program: decl.Program, robots: int, reason: str) -> Obligation:
    return Obligation(
        "together",
        "consistency",
        "",
        "",
        program.path,
        1,
        "QF_UFLIA",
        (),
        None,
        "sat",
        (),
        (),
        robots,
        (),
        None,
        reason,
    )


def _located(system: System, group: JointGroup, obligation: Obligation) -> Obligation:
    """Return an obligation whose facts have the files and lines of the programs from which they come."""
    paths = [system.applications[index].program.path for index in group.applications]
    facts = []
    for fact in obligation.facts:
        place, line = divmod(fact.line, LINES)
        facts.append(LabelledFormula(fact.label, fact.term, paths[place] if line else "", line, fact.position))
    return replace(obligation, facts=tuple(facts), file=" and ".join(dict.fromkeys(paths)))


# Groups of applications that mention the same things


class JointGroup(NamedTuple):
    """Assumptions and axioms of two or more applications that mention the same things.

    `applications`: their indices, ascending. `formulas`: the formulas, each with its application."""

    applications: tuple[int, ...]
    formulas: tuple[tuple[int, ir.Expr], ...]


class _Cluster:
    """Formulas that are connected by the things that they mention."""

    def __init__(self) -> None:
        self.applications: set[int] = set()
        self.formulas: list[tuple[int, ir.Expr]] = []
        self.subjects: set[tuple[Any, ...]] = set()


def connected(system: System) -> list[JointGroup]:
    """Return the groups of formulas of several applications that mention the same things.

    A formula that shares nothing with those of another application is left out: whether it contradicts others of its
    own application is asked when that application is proved."""
    clusters: list[_Cluster] = []
    for index, application in enumerate(system.applications):
        for formula in _assumed(application.program):
            found = _Cluster()
            found.applications, found.formulas = {index}, [(index, formula)]
            found.subjects = set(_subjects(system, index, formula))
            found.applications |= {subject[0] for subject in found.subjects if _is_variable(subject)}
            for other in [cluster for cluster in clusters if cluster.subjects & found.subjects]:
                clusters.remove(other)
                found.applications |= other.applications
                found.formulas += other.formulas
                found.subjects |= other.subjects
            clusters.append(found)
    shared = [cluster for cluster in clusters if len(cluster.applications) > 1]
    return [JointGroup(tuple(sorted(c.applications)), tuple(c.formulas)) for c in shared]


def _is_variable(subject: tuple[Any, ...]) -> bool:
    return len(subject) == 2


def _subjects(system: System, index: int, formula: ir.Expr) -> Iterator[tuple[Any, ...]]:
    """Yield the things that a formula of an application mentions: ports, spec functions, params and variables.

    A shared variable belongs to the application that declares it, because that gives the first value."""
    application = system.applications[index]
    for node in walk(formula):
        match node:
            case ir.PortRead(module, port) | ir.PortOf(module, port) | ir.PortCall(module, port):
                yield from ((robot, module, port) for robot in application.members)
            case ir.SharedRead(name) | ir.SlotRead(name) | ir.SlotsRead(name):
                yield system.owner(index, name), name
            case ir.LocalOf(name):
                yield "local", index, name
            case ir.ParamRead(name):
                yield "param", index, name
            case ir.Call(name) | ir.ExternCall(name):
                is_spec = any(spec.name == name for spec in application.program.specs)
                yield ("spec", *owner_of_spec(system, index, name)) if is_spec else ("function", index, name)


def _assumed(program: decl.Program) -> tuple[ir.Expr, ...]:
    formulas = [a.formula for module in program.modules for a in module.assumptions]
    formulas += [p.formula for p in program.properties if p.kind in ("initially", "axiom")]
    return tuple(formulas)


def owner_of_spec(system: System, index: int, name: str) -> tuple[int, str]:
    """Return the application that declares a spec function, which `index` may import, and the function's name."""
    for imported in system.applications[index].program.imports:
        if name in imported.specs:
            return owner_of_spec(system, system.exporter(index, imported), name)
    return index, name


# One program with the assumptions of a group


def merged(system: System, group: JointGroup, robot: int) -> decl.Program:
    """Return a program of all robots of the fleet with the assumptions and axioms of a group.

    What `initially` says of all members of an application is said of one robot, if others run no such application."""
    parts = [
        _Renamed(system, index, LINES * place, robot).program([f for owner, f in group.formulas if owner == index])
        for place, index in enumerate(group.applications)
    ]
    first = parts[0]

    def all_of(field: str) -> tuple[Any, ...]:
        return tuple([each for part in parts for each in getattr(part, field)])

    records = {record.type.name: record for record in all_of("records")}
    specs = {spec.name: spec for spec in all_of("specs")}
    return replace(
        first,
        records=tuple(records.values()),
        functions=all_of("functions"),
        externs=(),
        specs=tuple(specs.values()),
        params=all_of("params"),
        modules=_agreeing(all_of("modules")),
        shared=all_of("shared"),
        locals=all_of("locals"),
        locks=(),
        init=(),
        events=(),
        properties=all_of("properties"),
        exports=(),
        imports=(),
    )


def _agreeing(modules: tuple[decl.Module, ...]) -> tuple[decl.Module, ...]:
    """Return the modules with one direction for each port: a port that some program commands is an actuator."""
    commanded = {(m.name, p.name): p for m in modules for p in m.ports if p.direction == "actuator"}
    return tuple([replace(m, ports=tuple([commanded.get((m.name, p.name), p) for p in m.ports])) for m in modules])


class _Renamed:
    """Renaming of everything that belongs to one application; its pids become robots of the fleet.

    `raised`: the number that is added to each line.
    `place`: the robot of the question, by its place in the fleet."""

    def __init__(self, system: System, index: int, raised: int, place: int) -> None:
        self.system, self.index, self.raised, self.place = system, index, raised, place
        self.known: dict[str, int] = {}  # variable that denotes the robot at `place` -> its pid in the application
        self.application = system.applications[index]
        self.size = len(self.application.members)
        self.is_everywhere = self.application.members == tuple(range(system.robots))
        self.specs = {spec.name for spec in self.application.program.specs}

    def program(self, formulas: Collection[ir.Expr]) -> decl.Program:
        """Return the program with nothing but these of its assumptions and axioms, and what they read."""
        wanted = {id(formula) for formula in formulas}
        program = self.application.program
        imported = {name for each in program.imports for name in each.variables}
        sizes, pids = {i.size for i in program.imports}, {i.pid for i in program.imports}
        modules = [
            replace(
                m,
                assumptions=tuple(
                    [part for a in m.assumptions if id(a.formula) in wanted for part in self.assumptions(a)]
                ),
            )
            for m in program.modules
        ]
        kept = [p for p in program.properties if id(p.formula) in wanted]
        own_specs = [s for s in program.specs if owner_of_spec(self.system, self.index, s.name)[0] == self.index]
        return replace(
            program,
            functions=tuple([replace(self.moved(f), name=self.name(f.name)) for f in program.functions]),
            specs=tuple([replace(s, name=self.spec(s.name)) for s in own_specs]),
            params=tuple(
                [replace(self.moved(p), name=self.name(p.name)) for p in program.params if p.name not in sizes]
            ),
            modules=tuple(modules),
            shared=tuple(
                [replace(self.moved(v), name=self.name(v.name)) for v in program.shared if v.name not in imported]
            ),
            locals=tuple(
                [replace(self.moved(v), name=self.name(v.name)) for v in program.locals if v.name not in pids]
            ),
            properties=tuple([replace(self.moved(p), name=f"{self.application.name} {p.name}".strip()) for p in kept]),
        )

    def name(self, name: str) -> str:
        return f"{self.application.name}.{name}"

    def spec(self, name: str) -> str:
        owner, spec = owner_of_spec(self.system, self.index, name)
        return f"{self.system.applications[owner].name}.{spec}"

    def assumptions(self, assumption: decl.Assumption) -> Iterator[decl.Assumption]:
        """Yield the conjuncts of an assumption, each on the condition that the robot runs the application."""
        for part in conjuncts(assumption.formula):
            formula = self.moved(part)
            if not self.is_everywhere:
                outside = ir.Compare("<", self.pid(part.span), ir.Const(0, INT, part.span), BOOL, part.span)
                formula = ir.Logic("or", outside, formula, BOOL, part.span)
            yield decl.Assumption(formula, self.span(assumption.span))

    def span(self, span: Span) -> Span:
        return Span(span.line + self.raised, span.column, span.end_line + self.raised, span.end_column)

    def pid(self, span: Span) -> ir.Expr:
        """Return a robot's pid in the application, or -1, as an expression about its place in the fleet."""
        if self.is_everywhere:
            return ir.Pid(INT, span)
        members = self.application.members
        pids = [members.index(robot) if robot in members else -1 for robot in range(self.system.robots)]
        return _listed(pids, ir.Pid(INT, span), span)

    def robot(self, pid: ir.Expr) -> ir.Expr:
        """Return the place in the fleet of the application's member `pid`."""
        moved: ir.Expr = self.moved(pid)
        return moved if self.is_everywhere else _listed(list(self.application.members), moved, pid.span)

    def moved(self, node: Any) -> Any:
        """Return a node about the whole fleet, with the names and lines of the merged program."""
        found = self.placed(node)
        return replace(found, span=self.span(node.span)) if hasattr(node, "span") and found.span == node.span else found

    def placed(self, node: Any) -> Any:
        match node:
            case ir.Pid(_, span):
                return self.pid(span)
            case ir.NSys(_, span):
                return ir.Const(self.size, INT, span)
            case ir.Quantified("forall", name, ir.Ids(), body, _, span) if not self.is_everywhere:
                if self.place not in self.application.members:
                    return ir.Const(True, BOOL, span)
                self.known[name] = self.application.members.index(self.place)
                return self.moved(body)
            case ir.TempRead(name, _, span) if name in self.known:
                return ir.Const(self.known[name], INT, span)
            case ir.Ids(type_, span) if not self.is_everywhere:
                return ir.Make(tuple([ir.Const(i, INT, span) for i in range(self.size)]), type_, span)
            case ir.ParamRead(name, _, span):
                return self.param(node)
            case ir.LocalOf(name, robot):
                return self.local_of(node)
            case ir.PortOf(_, _, robot):
                return replace(node, robot=self.robot(robot))
            case ir.SlotRead(name, index):
                return replace(node, name=self.name(name), index=self.robot(index))
            case ir.SlotsRead(name, _, span):
                return self.all_slots(self.index, name, span)
            case ir.SharedRead(name):
                return self.shared(node)
            case ir.Call(name):
                called = self.spec(name) if name in self.specs else self.name(name)
                return map_children(replace(node, name=called), self.moved)
            case ir.ExternCall(name):
                return map_children(replace(node, name=self.name(name)), self.moved)
        return map_children(node, self.moved)

    def param(self, node: ir.ParamRead) -> ir.Expr:
        for imported in self.application.program.imports:
            if node.name == imported.size:
                exporter = self.system.applications[self.system.exporter(self.index, imported)]
                return ir.Const(len(exporter.members), INT, node.span)
        return replace(node, name=self.name(node.name))

    def local_of(self, node: ir.LocalOf) -> ir.Expr:
        for imported in self.application.program.imports:
            if node.name == imported.pid:
                others = self.system.applications[self.system.exporter(self.index, imported)].members
                pids = [others.index(r) if r in others else -1 for r in self.application.members]
                return _listed(pids, self.moved(node.robot), node.span)
        return replace(node, name=self.name(node.name), robot=self.robot(node.robot))

    def shared(self, node: ir.SharedRead) -> ir.Expr:
        owner = self.system.owner(self.index, node.name)
        for imported in self.application.program.imports:
            if node.name in imported.slots:
                return self.all_slots(owner, node.name, node.span)
        return replace(node, name=f"{self.system.applications[owner].name}.{node.name}")

    def all_slots(self, owner: int, name: str, span: Span) -> ir.Expr:
        """Return the slots of an application's members as a list."""
        application = self.system.applications[owner]
        type_ = next(v.type for v in application.program.shared if v.name == name)
        slots = [
            ir.SlotRead(f"{application.name}.{name}", ir.Const(robot, INT, span), False, type_, span)
            for robot in application.members
        ]
        return ir.Make(tuple(slots), list_of(type_), span)


def _listed(numbers: list[int], index: ir.Expr, span: Span) -> ir.Expr:
    """Return the number at an index of a list of numbers, as an expression."""
    known = ir.Make(tuple([ir.Const(number, INT, span) for number in numbers]), list_of(INT), span)
    return ir.At(known, index, False, INT, span)
