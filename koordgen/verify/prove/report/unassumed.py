"""Sensors of which no assumption says what they are after a step, so that any invariant about them fails; and what
could be assumed: that a robot stays in the box between where it is and its target."""

from __future__ import annotations

from collections.abc import Iterable

from koordgen.lang.ir import decl
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.types import BOOL, POINT, RECT
from koordgen.lang.node import replace
from koordgen.verify.prove.report.spell import nodes, spelled

Sensor = tuple[decl.Module, decl.Port]


def unassumed(program: decl.Program, invariant: decl.Property) -> list[Sensor]:
    """Those that an invariant speaks of."""
    read = {(n.module, n.port) for n in nodes(invariant.formula) if isinstance(n, ir.PortOf)}
    found = []
    for module in program.modules:
        told = [n for a in module.assumptions for n in nodes(a.formula) if isinstance(n, ir.PortRead) and n.primed]
        known = {n.port for n in told}
        for port in module.ports:
            if port.direction == "sensor" and (module.name, port.name) in read and port.name not in known:
                found.append((module, port))
    return found


def supposing(program: decl.Program, sensors: Iterable[Sensor]) -> tuple[decl.Program, tuple[str, ...]]:
    """The program with an assumption about each of those that have a target, and these as it would write them."""
    modules, texts = {m.name: m for m in program.modules}, []
    for module, port in sensors:
        ports = {p.name: p for p in module.ports}
        target = ports.get("target")
        if port.name != "position" or port.type != POINT or target is None or target.type != POINT:
            continue
        span = port.span
        now, after = (ir.PortRead(module.name, port.name, primed, POINT, span) for primed in (False, True))
        box = ir.Builtin("Rect", (now, ir.PortRead(module.name, "target", False, POINT, span)), RECT, span)
        formula = ir.Contains(after, box, BOOL, span)
        kept = modules[module.name]
        assumed = (*kept.assumptions, decl.Assumption(formula, span))
        modules[module.name] = replace(kept, assumptions=assumed)
        texts.append(f"using {module.name}: assume {spelled(formula).replace(f'{module.name}.', '')}")
    return replace(program, modules=tuple(modules.values())), tuple(texts)
