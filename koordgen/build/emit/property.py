"""A whole IR program -> the text of `properties.py`: its properties and port assumptions as plain Python, beside the
`program.py` whose records, params and functions they use. They mean what koordgen/lang/semantics/property.py says."""

from __future__ import annotations

import re
from collections.abc import Collection
from typing import Any

from koordgen import __version__
from koordgen.build.emit import expr, library, surely
from koordgen.build.emit.names import Names, snake
from koordgen.build.emit.render import render
from koordgen.build.emit.types import annotation, display
from koordgen.lang.ir import decl as ir
from koordgen.lang.ir import expr as e
from koordgen.lang.ir.types import POINT, POSE
from koordgen.lang.node import nodes

# Sensors of a body that a harness can measure itself, beside its position, by their types; all others the robot says.
_MEASURED = {"velocity": POINT, "pose": POSE}
_AXIOM = "an axiom is assumed"


class _Names(Names):
    """Of a formula: the ports of one robot stand at two moments, and none is a plain value."""

    formulas = True
    before, after = "before.", "after."

    def __init__(self, program: ir.Program) -> None:
        super().__init__(program)
        self.sensors = set()

    def function(self, wanted: str) -> str:
        """A name for what a formula becomes."""
        return self._mint(wanted)


def properties_text(program: ir.Program, driven: Collection[str] = ()) -> str:
    """The generated module, which compiles; anything else is a mistake of this compiler (SyntaxError). `driven` are the
    modules that are served by drivers of the user's own."""
    names = _Names(program)
    body = render("properties.py", **_values(program, names, driven)).strip("\n") + "\n"
    text = _head(program, names, body) + ("\n\n" if body.startswith(("class ", "def ")) else "\n") + body
    compile(text, "properties.py", "exec")
    return text


def _values(program: ir.Program, names: _Names, driven: Collection[str]) -> dict[str, Any]:
    unchecked = [(p, why) for p in program.properties if (why := _unchecked(p, program))]
    left = [p for p, _ in unchecked]
    properties = [_property(p, program, names) for p in program.properties if p not in left]
    places = [(m, a) for m in program.modules for a in m.assumptions]
    meant = [(m, a) for m, a in places if not _specs(a.formula, program)]
    assumptions = [_assumption(m, a, program, names) for m, a in meant]
    return {
        "name": program.name,
        "fleet": _fleet(program, names) if properties else [],
        "ports": _ports(program, names) if assumptions else [],
        "callables": _callables(program, names) if assumptions else [],
        "formulas": [*properties, *assumptions],
        "properties": properties,
        "assumptions": assumptions,
        "unchecked": [_left(p.kind, p.name, p.span.line, why) for p, why in unchecked]
        + [_left("assume", m.name, a.span.line, _specs(a.formula, program)) for m, a in places if (m, a) not in meant],
        "measured": _display(
            [
                f"{m.name}.{p.name}"
                for m in program.modules
                if m.name not in driven
                for p in m.ports
                if p.meaning.is_position or (p.direction == "sensor" and _MEASURED.get(p.name) == p.type)
            ]
        ),
    }


def _unchecked(property_: ir.Property, program: ir.Program) -> str:
    """Why it cannot be evaluated; empty when it can."""
    return _AXIOM if property_.kind == "axiom" else _specs(property_.formula, program)


def _specs(formula: e.Expr, program: ir.Program) -> str:
    specs = {s.name: s.span.line for s in program.specs}
    for node in nodes(formula):
        if isinstance(node, e.Call) and node.name in specs:
            return f"{node.name} (line {specs[node.name]}) is a spec fun: only axioms tell of it"
    return ""


def _left(kind: str, name: str, line: int, why: str) -> dict[str, Any]:
    return {"kind": kind, "name": expr.literal(name), "line": line, "why": expr.literal(why)}


def _property(property_: ir.Property, program: ir.Program, names: _Names) -> dict[str, Any]:
    own = f"_{snake(property_.name)}" if property_.name else ""
    line = property_.span.line
    return {
        "kind": property_.kind,
        "name": expr.literal(property_.name),
        "line": line,
        "function": names.function(f"{property_.kind}{own}"),
        "parameters": "s: Fleet",
        "mark": f"{property_.kind}{f' {property_.name}' if property_.name else ''}, {program.path}:{line}",
        "formula": expr.text(property_.formula, names),
        "reads": _display(_reads(property_.formula)),
        "surely": surely.text(property_.formula, names) if property_.kind == "invariant" else "",
    }


def _assumption(module: ir.Module, assumption: ir.Assumption, program: ir.Program, names: _Names) -> dict[str, Any]:
    line = assumption.span.line
    goals = [f"{names.temp(name)}: {annotation(type_, names)}" for name, type_ in ir.goals(assumption).items()]
    return {
        "module": expr.literal(module.name),
        "line": line,
        "function": names.function(f"assume_{snake(module.name)}"),
        "parameters": ", ".join(["s: Step", *goals]),
        "mark": f"assume of {module.name}, {program.path}:{line}",
        "formula": expr.text(assumption.formula, names),
        "reads": _display(_reads(assumption.formula)),
        "surely": surely.text_of_each(assumption.formula, names),
        "goals": display(list(dict.fromkeys([_asking(*found, names) for found in ir.handed(assumption.formula)]))),
    }


def _asking(call: e.PortCall, goals: dict[int, e.TempRead], names: Names) -> str:
    places = ", ".join([f"{place}: {expr.literal(names.temp(goal.name))}" for place, goal in goals.items()])
    return f"Asking({expr.literal(f'{call.module}.{call.port}')}, {len(call.args)}, {{{places}}})"


def _reads(formula: e.Expr) -> list[str]:
    """The names of ports, locals and shared variables that a formula reads."""
    found: list[str] = []
    for node in nodes(formula):
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


def _fleet(program: ir.Program, names: Names) -> list[tuple[str, str, str, str]]:
    """Attribute, whether each robot has one, type and name of all that properties may read."""
    ports = [
        (names.ports[m.name, p.name], "Each", annotation(p.type, names), expr.literal(f"{m.name}.{p.name}"))
        for m in program.modules
        for p in m.ports
        if p.direction in ("sensor", "actuator")
    ]
    shared = [
        (
            names.shared[v.name],
            "Each" if v.kind == "allread" else "One",
            annotation(v.type, names),
            expr.literal(v.name),
        )
        for v in program.shared
    ]
    own = [(names.locals[v.name], "Each", annotation(v.type, names), expr.literal(v.name)) for v in program.locals]
    return [*ports, *shared, *own]


def _ports(program: ir.Program, names: Names) -> list[tuple[str, str, str]]:
    return [
        (names.ports[m.name, p.name], annotation(p.type, names), expr.literal(f"{m.name}.{p.name}"))
        for m in program.modules
        for p in m.ports
        if p.direction in ("sensor", "actuator")
    ]


def _callables(program: ir.Program, names: Names) -> list[tuple[str, str, str]]:
    return [
        (names.ports[m.name, p.name], annotation(p.type, names), expr.literal(f"{m.name}.{p.name}"))
        for m in program.modules
        for p in m.ports
        if p.direction == "callable"
    ]


def _head(program: ir.Program, names: Names, body: str) -> str:
    own = {*names.params.values(), *names.records.values(), *names.functions.values(), *names.externs.values()}
    own |= {"PROGRAM", *names.extern_types.values()}
    used = sorted(own & set(re.findall(r"(?<![\w.\"'])[A-Za-z_]\w*", body)))
    groups = [group for group in library.imports(body) if group]
    groups.append([f"from program import {', '.join(used)}"])
    return (
        f'"""{program.name}: the properties of the Koord program {program.path}, by koordgen {__version__}.\n\n'
        'The next build writes this file anew: change the Koord program, not this.\n"""\n\n'
        "from __future__ import annotations\n\n" + "\n\n".join("\n".join(group) for group in groups) + "\n"
    )
