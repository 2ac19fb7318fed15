"""IR program -> text of `properties.py`: properties, guarantees and port assumptions as Python functions.

The module imports records, params and functions from `program.py`. Meaning of formulas:
koordgen/lang/semantics/property.py.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any, cast

from koordgen import __version__
from koordgen.build.emit import expr, library, screening
from koordgen.build.emit.layout import STEP, Page, brackets, display, joined, text
from koordgen.build.emit.names import Names, snake
from koordgen.build.emit.program import add_callable, add_imports, add_notes, add_table
from koordgen.build.emit.types import annotation
from koordgen.lang.ir import decl as ir
from koordgen.lang.ir import expr as e
from koordgen.lang.ir.tree import transform, walk
from koordgen.lang.ir.types import POINT, POSE, Type
from koordgen.lang.node import Node

# Sensors with their types that a harness can measure itself, besides the position. The robot reports all others.
_MEASURED = {"velocity": POINT, "pose": POSE}
_AXIOM = "an axiom is assumed"
_NOTES = '# As in program.py. Where a line says "discards the event", a formula has no value:'


class _Names(Names):
    """Names in formulas. A port has a value before and one after a step. Sensors are read through `.value`."""

    formulas = True
    before, after = "before.", "after."

    def __init__(self, program: ir.Program) -> None:
        super().__init__(program)
        self.sensors = set()
        self.shared |= {_after(v.name): self._mint(f"shared_{v.name}_after") for v in _compared(program)}

    def function(self, wanted: str) -> str:
        """Return a new name for the function of a formula."""
        return self._mint(wanted)


def has_properties(program: ir.Program) -> bool:
    """Return whether the program has properties, guarantees or port assumptions.

    A bundle without any has no `properties.py`.
    """
    guaranteed = any(export.guarantees for export in program.exports)
    return bool(program.properties) or guaranteed or any(m.assumptions for m in program.modules)


def properties_text(program: ir.Program, driven: Collection[str] = (), module: str = "program") -> str:
    """Return the text of the generated module.

    `driven`: modules that the user's drivers serve. `module`: name of the module with the generated program. The text
    is compiled once as a check: a SyntaxError is a bug of this compiler.
    """
    names = _Names(program)
    page = Page()
    places = [(m, a) for m in program.modules for a in m.assumptions]
    checked = [p for p in program.properties if not _unchecked(p, program)]
    guarantees = [(export.variable, g) for export in program.exports for g in export.guarantees]
    kept = [(variable, g) for variable, g in guarantees if not _specs(g.formula, program)]
    meant = [(m, a) for m, a in places if not _specs(a.formula, program)]
    if checked or kept:
        _add_fleet(page, program, names)
    if meant:
        _add_step(page, program, names)
    properties = [_property(page, p, program, names) for p in checked]
    properties += [_guarantee(page, variable, g, program, names) for variable, g in kept]
    assumptions = [_assumption(page, m, a, program, names) for m, a in meant]
    left = [
        _left(p.kind, p.name, p.span.line, why, names) for p in program.properties if (why := _unchecked(p, program))
    ]
    left += [_left("assume", m.name, a.span.line, why, names) for m, a in places if (why := _specs(a.formula, program))]
    left += [
        _left("guarantee", g.name, g.span.line, why, names)
        for _, g in guarantees
        if (why := _specs(g.formula, program))
    ]
    page.gap(2 if page.lines else 1)
    known = names.use("Known")
    page.add(f"PROPERTIES = {names.use('Properties')}(")
    page.add(f"program={names.use('PROGRAM')},", STEP)
    page.add(f"fleet={'Fleet' if checked or kept else known},", STEP)
    page.add(f"step={'Step' if meant else known},", STEP)
    add_table(page, "properties", properties)
    add_table(page, "assumptions", assumptions)
    add_table(page, "unchecked", left)
    page.add(joined("measured=", _display(_measured(program, driven)), ","), STEP)
    page.add(")")
    found = text(_head(program, names, module), page)
    compile(found, "properties.py", "exec")
    return found


def _measured(program: ir.Program, driven: Collection[str]) -> list[str]:
    return [
        f"{m.name}.{p.name}"
        for m in program.modules
        if m.name not in driven
        for p in m.ports
        if p.meaning.is_position or (p.direction == "sensor" and _MEASURED.get(p.name) == p.type)
    ]


def _unchecked(property_: ir.Property, program: ir.Program) -> str:
    """Return the reason why a property cannot be evaluated, or ""."""
    return _AXIOM if property_.kind == "axiom" else _specs(property_.formula, program)


def _specs(formula: e.Expr, program: ir.Program) -> str:
    specs = {s.name: s.span.line for s in program.specs}
    for node in walk(formula):
        if isinstance(node, e.Call) and node.name in specs:
            return f"{node.name} (line {specs[node.name]}) is a spec fun, which only axioms describe"
    return ""


def _left(kind: str, name: str, line: int, why: str, names: Names) -> tuple[str, int]:
    arguments = [f'kind="{kind}"', f"name={expr.literal(name)}", f"line={line}", f"why={expr.literal(why)}"]
    return brackets(f"{names.use('Unchecked')}(", arguments, ")"), 0


def _property(page: Page, property_: ir.Property, program: ir.Program, names: _Names) -> tuple[str, int]:
    """Add the function of a property. Return the property's entry for `PROPERTIES`, and 0 as its line."""
    own = f"_{snake(property_.name)}" if property_.name else ""
    line = property_.span.line
    function = names.function(f"{property_.kind}{own}")
    mark = f"{property_.kind}{f' {property_.name}' if property_.name else ''}, {program.path}:{line}"
    _add_function(page, function, ["s: Fleet"], mark, expr.text(property_.formula, names))
    enough = screening.text(property_.formula, names) if property_.kind == "invariant" else ""
    arguments = [
        f'kind="{property_.kind}"',
        f"name={expr.literal(property_.name)}",
        f"line={line}",
        f"holds={function}",
        joined("reads=", _display(_reads(property_.formula))),
        *_screening(page, function, enough, names),
    ]
    return brackets(f"{names.use('Property')}(", arguments, ")"), 0


def _guarantee(
    page: Page, variable: str, guarantee: ir.Guarantee, program: ir.Program, names: _Names
) -> tuple[str, int]:
    """Add the function of a guarantee. Return the guarantee's entry for `PROPERTIES`, and 0 as its line.

    The formula reads the exported variable. The value after a write is a variable whose name has a prime.
    """
    line, name = guarantee.span.line, guarantee.name
    formula = _of_variable(variable, guarantee, program)
    function = names.function(f"guarantee_{snake(name)}")
    _add_function(page, function, ["s: Fleet"], f"guarantee {name}, {program.path}:{line}", expr.text(formula, names))
    arguments = [
        'kind="guarantee"',
        f"name={expr.literal(name)}",
        f"line={line}",
        f"holds={function}",
        joined("reads=", _display(_reads(formula))),
    ]
    return brackets(f"{names.use('Property')}(", arguments, ")"), 0


def _of_variable(variable: str, guarantee: ir.Guarantee, program: ir.Program) -> e.Expr:
    """Return the formula of a guarantee as one of shared variables: the exported one, and the one after a write."""
    is_slots = next(v for v in program.shared if v.name == variable).kind == "allread"
    read = {guarantee.before: variable, guarantee.after: _after(variable)}

    def replaced(node: Any) -> Node:
        found: Node = node
        if isinstance(node, e.TempRead) and node.name in read:
            kind = e.SlotsRead if is_slots else e.SharedRead
            found = kind(read[node.name], node.type, node.span)
        return found

    return cast("e.Expr", transform(guarantee.formula, replaced))


def _after(variable: str) -> str:
    """Return the name of an exported variable's value after a write."""
    return f"{variable}'"


def _compared(program: ir.Program) -> list[ir.Shared]:
    """Return the variables with a guarantee about the value after a write."""
    names = {export.variable for export in program.exports if any(map(ir.is_step, export.guarantees))}
    return [v for v in program.shared if v.name in names]


def _assumption(
    page: Page, module: ir.Module, assumption: ir.Assumption, program: ir.Program, names: _Names
) -> tuple[str, int]:
    """Add the function of an assumption. Return the assumption's entry for `PROPERTIES`, and 0 as its line."""
    line = assumption.span.line
    goals = [joined(f"{names.temp(g)}: ", annotation(type_, names)) for g, type_ in ir.goals(assumption).items()]
    function = names.function(f"assume_{snake(module.name)}")
    mark = f"assume of {module.name}, {program.path}:{line}"
    _add_function(page, function, ["s: Step", *goals], mark, expr.text(assumption.formula, names))
    asked = list(dict.fromkeys([_asking(*found, names) for found in ir.handed(assumption.formula)]))
    arguments = [
        f"module={expr.literal(module.name)}",
        f"line={line}",
        f"holds={function}",
        joined("reads=", _display(_reads(assumption.formula))),
        joined("goals=", display(asked)),
        *_screening(page, function, screening.text_of_each(assumption.formula, names), names),
    ]
    return brackets(f"{names.use('Assumption')}(", arguments, ")"), 0


def _add_function(page: Page, name: str, parameters: Sequence[str], mark: str, formula: str) -> None:
    page.gap()
    page.add(joined(brackets(f"def {name}(", parameters, ")"), " -> bool:"))
    page.add(f'"""{mark}"""', STEP)
    page.add(joined("return ", formula), STEP)


def _screening(page: Page, function: str, enough: str, names: Names) -> list[str]:
    """Add the screening function of a formula. Return the keyword argument that names it; [] without a screening."""
    if not enough:
        return []
    page.gap()
    page.add(f"def screening_{function}(b: {names.use('Any')}) -> Any:")
    page.add('"""Screening of many observations at once: the formula holds wherever the result is true."""', STEP)
    page.add(joined("return ", enough), STEP)
    return [f"screening=screening_{function}"]


def _asking(call: e.PortCall, goals: dict[int, e.TempRead], names: Names) -> str:
    places = ", ".join([f"{place}: {expr.literal(names.temp(goal.name))}" for place, goal in goals.items()])
    port = expr.literal(f"{call.module}.{call.port}")
    return brackets(
        f"{names.use('GoalCall')}(", [f"port={port}", f"arguments={len(call.args)}", f"goals={{{places}}}"], ")"
    )


def _reads(formula: e.Expr) -> list[str]:
    """Return the names of ports, locals and shared variables that a formula reads."""
    found: list[str] = []
    for node in walk(formula):
        match node:
            case e.LocalOf(name) | e.SlotRead(name) | e.SlotsRead(name) | e.SharedRead(name):
                found.append(name)
            case e.PortOf(module, port):
                found.append(f"{module}.{port}")
            case e.PortRead(module, port, primed):
                found.append(f"{module}.{port}" + ("'" if primed else ""))
            case _:
                pass
    return list(dict.fromkeys(found))


def _display(found: list[str]) -> str:
    return display([expr.literal(name) for name in found])


def _add_fleet(page: Page, program: ir.Program, names: Names) -> None:
    """Add the class Fleet, from which properties read the state of all robots."""
    page.gap()
    page.add(f"class Fleet({names.use('Known')}):")
    page.add(f'"""State of all robots at one time, for the properties of {program.name}."""', STEP)
    _add_init(page, names)
    for m, p in _ports(program, "sensor", "actuator"):
        _add_part(page, names.ports[m.name, p.name], "Each", p.type, f"{m.name}.{p.name}", names)
    for v in program.shared:
        kind = "Each" if v.kind == "allread" else "One"
        _add_part(page, names.shared[v.name], kind, v.type, v.name, names)
    for v in _compared(program):
        kind = "Each" if v.kind == "allread" else "One"
        _add_part(page, names.shared[_after(v.name)], kind, v.type, _after(v.name), names)
    for w in program.locals:
        _add_part(page, names.locals[w.name], "Each", w.type, w.name, names)


def _add_init(page: Page, names: Names) -> None:
    page.gap(1)
    page.add(f"def __init__(self, n_sys: int, trail: {names.use('Trail')} | None = None) -> None:", STEP)
    page.add("super().__init__(n_sys, trail)", STEP * 2)


def _add_part(page: Page, attribute: str, kind: str, type_: Type, name: str, names: Names) -> None:
    held = brackets(f"{names.use(kind)}[", [annotation(type_, names)], "]")
    page.add(joined(f"self.{attribute}: ", held, f" = self.of_{kind.lower()}({expr.literal(name)})"), STEP * 2)


def _ports(program: ir.Program, *directions: str) -> list[tuple[ir.Module, ir.Port]]:
    return [(m, p) for m in program.modules for p in m.ports if p.direction in directions]


def _add_step(page: Page, program: ir.Program, names: Names) -> None:
    """Add the classes Ports and Step, from which assumptions read the ports of a robot."""
    page.gap()
    page.add("class Ports:")
    page.add('"""One robot\'s ports."""', STEP)
    page.gap(1)
    page.add(f'def __init__(self, known: {names.use("Known")}, prime: str = "") -> None:', STEP)
    for m, p in _ports(program, "sensor", "actuator"):
        held = brackets(f"{names.use('One')}[", [annotation(p.type, names)], "]")
        value = f"known.of_one({expr.literal(f'{m.name}.{p.name}')} + prime)"
        page.add(joined(f"self.{names.ports[m.name, p.name]}: ", held, f" = {value}"), STEP * 2)
    page.gap()
    page.add("class Step(Known):")
    page.add('"""Ports of one robot for assumptions: `before` has the values right after the program\'s step,', STEP)
    page.add('`after` has the values at a later time of the same round."""', STEP)
    _add_init(page, names)
    page.add("self.before = Ports(self)", STEP * 2)
    page.add('self.after = Ports(self, "\'")', STEP * 2)
    for m, p in _ports(program, "callable"):
        name = expr.literal(f"{m.name}.{p.name}")
        add_callable(page, names.ports[m.name, p.name], annotation(p.type, names), name, "answer", names)


def _head(program: ir.Program, names: Names, module: str) -> Page:
    own = {*names.params.values(), *names.records.values(), *names.functions.values(), *names.externs.values()}
    own |= {"PROGRAM", *names.extern_types.values()}
    page = Page()
    page.add(f'"""{program.name}: the properties of the Koord program {program.path}, by koordgen {__version__}.')
    page.gap(1)
    page.add("The next build overwrites this file: change the Koord program instead.")
    page.add('"""')
    add_imports(page, [*library.imports(names.used), library.imported(module, sorted(own & names.used))])
    add_notes(page, names, _NOTES)
    return page
