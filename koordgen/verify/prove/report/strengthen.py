"""Strengthening: finds conjuncts that make an invariant inductive.

A candidate is a conjunct of an invariant or of an `initially` property, with one variable replaced by another variable
of the same type. For example, a bound of targets becomes a bound of positions. The Houdini algorithm finds the
candidates that hold together: it assumes all candidates and drops those that fail, until none fails. Then the
candidates that the proof does not need are removed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

from koordgen.lang.ir import decl
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.tree import map_children, walk
from koordgen.lang.ir.types import BOOL, INT, POINT, RECT, Type, list_of
from koordgen.lang.node import replace
from koordgen.verify.prove.report.koord_text import to_koord

MAX_CANDIDATES = 24  # largest number of candidates that are tried
MARK = "(candidate)"

Proves = Callable[[decl.Program, frozenset[str]], frozenset[str]]


def strengthening(program: decl.Program, invariant: str, proves: Proves) -> tuple[str, ...]:
    """Return conjuncts, as Koord text, that make the invariant inductive; empty if none are found.

    `program`: the program with `invariant` and the invariants that may be assumed.
    `proves`: takes a program and names of invariants. It returns the names of the invariants that every step preserves,
        if all invariants of the program are assumed."""
    for blocks in (True, False):
        found = _strengthening(program, invariant, _candidates(program, invariant, blocks), proves)
        if found:
            return found
    return ()


def _strengthening(
    program: decl.Program, invariant: str, candidates: list[decl.Property], proves: Proves
) -> tuple[str, ...]:
    names = {c.name for c in candidates}
    while candidates:
        kept = proves(_with(program, candidates), frozenset({invariant, *names}))
        if names <= kept:
            break
        candidates = [c for c in candidates if c.name in kept]
        names = {c.name for c in candidates}
    if not candidates or invariant not in proves(_with(program, candidates), frozenset({invariant})):
        return ()
    for candidate in list(candidates):
        fewer = [c for c in candidates if c is not candidate]
        wanted = frozenset({invariant, *(c.name for c in fewer)})
        if wanted <= proves(_with(program, fewer), wanted):
            candidates = fewer
    return tuple([to_koord(c.formula) for c in candidates])


def _with(program: decl.Program, more: Iterable[decl.Property]) -> decl.Program:
    return replace(program, properties=(*program.properties, *more))


def _candidates(program: decl.Program, invariant: str, blocks: bool) -> list[decl.Property]:
    """Return candidate conjuncts for a strengthening of the invariant.

    If `blocks`, all conjuncts about one variable form one candidate, in which the variable is replaced by another
    variable.
    """
    known = [p for p in program.properties if p.kind in ("invariant", "initially")]
    known.sort(key=lambda p: p.name != invariant)  # conjuncts of the invariant come before all others
    present = {to_koord(c) for p in known if p.kind == "invariant" for c in conjuncts(p.formula)}
    found: dict[str, ir.Expr] = {}
    for property_ in known:
        parts = list(conjuncts(property_.formula))
        for conjunct in _blocks(parts) if blocks else parts:
            for formula in (conjunct, *_variants(conjunct, program)):
                text = to_koord(formula)
                if text not in present:
                    found.setdefault(text, formula)
    for formula in _bounds(program):
        text = to_koord(formula)
        if text not in present:
            found.setdefault(text, formula)
    span = next(p.span for p in known if p.name == invariant)
    chosen = list(found.values())[:MAX_CANDIDATES]
    return [decl.Property("invariant", f"{MARK} {i}", formula, span) for i, formula in enumerate(chosen)]


def _bounds(program: decl.Program) -> Iterator[ir.Expr]:
    """Yield bounds of int variables: "never below the initial value" and "never above the initial value"."""
    variables: list[decl.Local | decl.Shared] = [*program.locals, *program.shared]
    for variable in variables:
        first, span = variable.initial, variable.span
        literal = first.operand if isinstance(first, ir.Unary) else first
        if variable.type != INT or not isinstance(literal, ir.Const):
            continue
        robot = ir.TempRead("i", INT, span)
        everyone = True
        match variable:
            case decl.Local(name):
                read: ir.Expr = ir.LocalOf(name, robot, INT, span)
            case decl.Shared(name, "allread"):
                read = ir.SlotRead(name, robot, False, INT, span)
            case _:
                read, everyone = ir.SharedRead(variable.name, INT, span), False
        for op in (">=", "<="):
            bound: ir.Expr = ir.Compare(op, read, first, BOOL, span)
            yield ir.Quantified("forall", "i", ir.Ids(list_of(INT), span), bound, BOOL, span) if everyone else bound


def conjuncts(node: ir.Expr) -> Iterator[ir.Expr]:
    """Yield the conjuncts of a formula. A `forall` over a conjunction becomes one `forall` per conjunct."""
    match node:
        case ir.Logic("and", left, right):
            yield from conjuncts(left)
            yield from conjuncts(right)
        case ir.Quantified("forall", name, domain, body, type_, span):
            for part in conjuncts(body):
                yield ir.Quantified("forall", name, domain, part, type_, span)
        case _:
            yield node


def _blocks(parts: list[ir.Expr]) -> list[ir.Expr]:
    """Join conjuncts that have the same quantifier and mention only the same single variable."""
    found: dict[object, ir.Expr] = {}
    for part in parts:
        about = {_key(node) for node in walk(part)} - {None}
        match part:
            case ir.Quantified("forall", name, domain, body, type_, span) if len(about) == 1:
                key = (name, domain, *about)
                before = found.get(key)
                joined = ir.Logic("and", before.body, body, BOOL, span) if isinstance(before, ir.Quantified) else body
                found[key] = ir.Quantified("forall", name, domain, joined, type_, span)
            case _:
                found[part] = part
    return list(found.values())


def _variants(formula: ir.Expr, program: decl.Program) -> Iterator[ir.Expr]:
    """Yield variants of a formula in which one variable is replaced by another variable of the same type."""
    subjects: dict[tuple[str, str], Type] = {}
    for node in walk(formula):
        key = _key(node)
        if key is not None and isinstance(node, _READS):
            subjects.setdefault(key, node.type)
    for key, type_ in subjects.items():
        for other in _variables(program):
            if other[1] == type_ and other[0] != key:
                yield _renamed(formula, key, other[0])
    for key, type_ in subjects.items():
        for shared in program.shared:
            if shared.kind == "allwrite" and shared.type == type_ and key[0] != "":
                yield _renamed(formula, key, ("", shared.name))


def _variables(program: decl.Program) -> Iterator[tuple[tuple[str, str], Type]]:
    """Yield every variable that exists once per robot: its key and its type."""
    for module in program.modules:
        for port in module.ports:
            if port.direction in ("actuator", "sensor"):
                yield (f"port {module.name}", port.name), port.type
    for shared in program.shared:
        if shared.kind == "allread":
            yield ("slot", shared.name), shared.type
    for local in program.locals:
        yield ("local", local.name), local.type


_READS = (ir.PortOf, ir.SlotRead, ir.LocalOf)


def _key(node: object) -> tuple[str, str] | None:
    match node:
        case ir.PortOf(module, port):
            return f"port {module}", port
        case ir.SlotRead(name):
            return "slot", name
        case ir.LocalOf(name):
            return "local", name
        case _:
            return None


def _renamed(node: ir.Expr, key: tuple[str, str], other: tuple[str, str]) -> ir.Expr:
    """Replace all reads of the variable `key` by reads of `other`, except inside the index of such a read."""
    if isinstance(node, _READS) and _key(node) == key:
        return _read(other, node.index if isinstance(node, ir.SlotRead) else node.robot, node)
    return map_children(node, lambda child: _renamed(child, key, other))


def _read(key: tuple[str, str], robot: ir.Expr, like: Any) -> ir.Expr:
    kind, name = key
    match kind:
        case "":
            return ir.SharedRead(name, like.type, like.span)
        case "slot":
            return ir.SlotRead(name, robot, False, like.type, like.span)
        case "local":
            return ir.LocalOf(name, robot, like.type, like.span)
        case _:
            return ir.PortOf(kind.removeprefix("port "), name, robot, like.type, like.span)


# Sensors that no assumption constrains after a step, so that every invariant about them fails. The suggested assumption
# about such a sensor: the robot stays in the box between its position and its target.

Sensor = tuple[decl.Module, decl.Port]


def unassumed(program: decl.Program, invariant: decl.Property) -> list[Sensor]:
    """Return the sensors that an invariant mentions and that no assumption constrains after a step."""
    read = {(n.module, n.port) for n in walk(invariant.formula) if isinstance(n, ir.PortOf)}
    found = []
    for module in program.modules:
        told = [n for a in module.assumptions for n in walk(a.formula) if isinstance(n, ir.PortRead) and n.primed]
        known = {n.port for n in told}
        for port in module.ports:
            if port.direction == "sensor" and (module.name, port.name) in read and port.name not in known:
                found.append((module, port))
    return found


def with_position_assumptions(program: decl.Program, sensors: Iterable[Sensor]) -> tuple[decl.Program, tuple[str, ...]]:
    """Add an assumption about each position sensor among `sensors` that has a target.

    A sensor has a target if an actuator sends the robot to a position. Returns the program with the new assumptions,
    and the texts of these assumptions."""
    modules, texts = {m.name: m for m in program.modules}, []
    for module, port in sensors:
        goal = next((p.name for p in module.ports if p.meaning.held == port.name), None)
        if not port.meaning.is_position or goal is None:
            continue
        span = port.span
        now, after = (ir.PortRead(module.name, port.name, primed, POINT, span) for primed in (False, True))
        box = ir.Builtin("Rect", (now, ir.PortRead(module.name, goal, False, POINT, span)), RECT, span)
        formula = ir.Contains(after, box, BOOL, span)
        kept = modules[module.name]
        assumed = (*kept.assumptions, decl.Assumption(formula, span))
        modules[module.name] = replace(kept, assumptions=assumed)
        texts.append(f"using {module.name}: assume {to_koord(formula).replace(f'{module.name}.', '')}")
    return replace(program, modules=tuple(modules.values())), tuple(texts)
