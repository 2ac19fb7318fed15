"""Statements: types, who may write what, what can run at all, and what is known afterwards."""

from __future__ import annotations

from typing import assert_never

from koordgen.check import bounds, linear
from koordgen.check.context import PREDEFINED, Context, Temp
from koordgen.check.decide import relevant, unsat
from koordgen.check.expr import arithmetic, check_expr, condition, fitting
from koordgen.check.facts import Flow, formula, known_value, variable_of
from koordgen.diagnostics import Label
from koordgen.ir import expr as ir
from koordgen.ir import stmt
from koordgen.ir.decl import Local, Module, Param, Shared
from koordgen.ir.types import BOOL, FLOAT, INT, POINT, POISON, Scalar
from koordgen.source import Span
from koordgen.syntax import expr as ast
from koordgen.syntax import stmt as tree
from koordgen.syntax.mistake import LATER_TYPES

Target = tuple[stmt.Place, Scalar, ir.Expr]  # where to write, of what type, and how it is read


def check_block(block: tree.Block, c: Context) -> stmt.Block:
    """The statements of a block; its declarations end with it. `c.flow` is None afterwards if it always stops."""
    c.scopes.append({})
    checked: list[stmt.Stmt] = []
    told = False
    for statement in block:
        if c.flow is None and not told and not isinstance(statement, tree.Pass):
            c.warn("K043", "this statement can never run: every way to it has stopped", statement.span)
            told = True
        done = _check(statement, c)
        if done is not None:
            checked.append(done)
    c.scopes.pop()
    return tuple(checked)


def _check(node: tree.Stmt, c: Context) -> stmt.Stmt | None:
    match node:
        case tree.Assign():
            return _assign(node, c)
        case tree.Declare():
            return _declare(node, c)
        case tree.If():
            return _if(node, c)
        case tree.Evaluate():
            _evaluate(node, c)
            return None
        case tree.Pass():
            return None
        case tree.Stop(span):
            c.flow = None
            return stmt.Stop(span)
        case _:
            assert_never(node)


def default(type_: Scalar, span: Span) -> ir.Expr:
    """The value of a variable that is given none."""
    if type_ == POINT:
        zero = ir.Const(0.0, FLOAT, span)
        return ir.Builtin("Point", (zero, zero, zero), POINT, span)
    return ir.Const({INT: 0, FLOAT: 0.0, BOOL: False}.get(type_, 0), type_, span)


def _assign(node: tree.Assign, c: Context) -> stmt.Stmt | None:
    value = check_expr(node.value, c)
    target = _target(node.target, c)
    if target is None:
        return None
    place, type_, read = target
    if node.op:
        if isinstance(place, stmt.SharedPlace):
            c.read_shared.add(place.name)
        value = arithmetic(node.op, read, value, node.span, c)
    value = fitting(value, type_, c.text(node.target.span), c)
    if isinstance(place, stmt.SharedPlace) and place.name in c.read_shared:
        help = "another robot may write it in the same round: the highest pid wins, the others' work is lost"
        c.warn("K040", f"this event reads {place.name} and writes it: an update may be lost", node.span, help)
        c.read_shared.discard(place.name)
    _learn(place, value, c)
    return None if POISON in (value.type, type_) else stmt.Assign(place, value, node.span)


def _learn(place: stmt.Place, value: ir.Expr, c: Context) -> None:
    name = variable_of(place)
    if c.flow is not None and name is not None:
        c.flow = c.flow.assigned(name, None if value.type == POISON else known_value(value, c.flow))


def _target(node: ast.Expr, c: Context) -> Target | None:
    """What an assignment writes; None after reporting that it cannot."""
    match node:
        case ast.Name():
            return _named(node, c)
        case ast.Index(ast.Name(name) as value):
            entity = c.entities.get(name)
            if c.temp(name) is None and isinstance(entity, Shared) and entity.kind == "allread":
                return _slot(node, entity, c)
            check_expr(node if name in c.entities or c.temp(name) else value, c)
            return None
        case ast.Attribute(ast.Name(name)) if c.temp(name) is None and isinstance(c.entities.get(name), Module):
            return _port(node, c)
        case ast.Attribute():
            if check_expr(node, c).type != POISON:
                help = "assign a whole Point: p = Point(x, y, z)"
                c.error("K022", f"{c.text(node.span)} is a part of a value and cannot be assigned", node.span, help)
            return None
        case _:
            if check_expr(node, c).type != POISON:
                c.error("K022", f"{c.text(node.span)} cannot be assigned", node.span)
            return None


def _named(node: ast.Name, c: Context) -> Target | None:
    name, span = node.name, node.span
    temp = c.temp(name)
    if temp is not None:
        return stmt.TempPlace(temp.unique), temp.type, ir.TempRead(temp.unique, temp.type, span)
    match c.entities.get(name):
        case Local(type=type_):
            return stmt.LocalPlace(name), type_, ir.LocalRead(name, type_, span)
        case Shared(kind="allwrite", type=type_):
            return stmt.SharedPlace(name), type_, ir.SharedRead(name, type_, span)
        case Shared():
            c.error("K017", f"{name} has a value for each robot and needs an index", span, f"write {name}[pid] = ...")
        case Param():
            c.error("K022", f"{name} is a param and cannot be assigned", span, "declare it under 'local:'")
        case Module():
            c.error("K022", f"{name} is a module and cannot be assigned", span)
        case None if name in PREDEFINED:
            c.error("K022", f"{name} is predefined and cannot be assigned", span)
        case None if name not in c.entities:
            help = c.nearest(name, [n for n in c.visible() if n not in PREDEFINED])
            c.error("K010", f"{name} is not defined", span, help or f"declare it: 'Type {name} = ...'")
    return None


def _slot(node: ast.Index, entity: Shared, c: Context) -> Target | None:
    index = fitting(check_expr(node.index, c), INT, "an index", c)
    if POISON in (index.type, entity.type):
        return None
    if not bounds.is_own(index, c):
        message = f"{c.text(node.span)} may be another robot's slot; a robot writes {entity.name}[pid] only"
        c.error("K021", message, node.span, f"write {entity.name}[pid] = ...")
        return None
    return (
        stmt.OwnSlot(entity.name),
        entity.type,
        ir.SlotRead(entity.name, ir.Pid(INT, index.span), True, entity.type, node.span),
    )


def _port(node: ast.Attribute, c: Context) -> Target | None:
    read = check_expr(node, c)
    if not isinstance(read, ir.PortRead):
        return None
    module = c.entities[read.module]
    assert isinstance(module, Module)
    port = next(p for p in module.ports if p.name == read.port)
    if port.direction == "sensor":
        label = Label(port.span, "declared as a sensor")
        c.error("K020", f"{read.module}.{read.port} is a sensor and cannot be assigned", node.span, labels=(label,))
        return None
    return stmt.PortPlace(read.module, read.port), read.type, read


def _declare(node: tree.Declare, c: Context) -> stmt.Stmt | None:
    type_ = c.type_named(node.type, node.type_span)
    value = default(type_, node.span) if node.value is None else check_expr(node.value, c)
    value = fitting(value, type_, node.name, c)
    if type_ == POISON and node.type not in LATER_TYPES and node.value is None:
        return None  # `assert b`, `del n`: no declaration was meant
    earlier = c.temp(node.name)
    known = c.entities.get(node.name)
    if earlier is not None or node.name in c.entities or node.name in PREDEFINED:
        span = earlier.span if earlier else known.span if known else None
        labels = (Label(span, "declared here first"),) if span else ()
        what = "is predefined" if node.name in PREDEFINED else "is declared already"
        c.error("K011", f"{node.name} {what}", node.name_span, "choose another name", labels)
        return None
    temp = Temp(c.mint(node.name), type_, node.name_span)
    c.scopes[-1][node.name] = temp
    _learn(stmt.TempPlace(temp.unique), value, c)
    return None if POISON in (value.type, type_) else stmt.Let(temp.unique, type_, value, node.span)


def _evaluate(node: tree.Evaluate, c: Context) -> None:
    if isinstance(node.value, ast.Call):
        if check_expr(node.value, c).type != POISON:
            c.error("K024", "the result of this call is not used", node.span)
    elif isinstance(node.value, ast.Compare) and node.value.rest[0][0] == "==":
        c.error("K024", "this compares and does nothing", node.span, "'=' assigns")
    elif check_expr(node.value, c).type != POISON:
        c.error("K024", "this is a value and does nothing", node.span)


def _if(node: tree.If, c: Context) -> stmt.Stmt | None:
    """Each branch knows its own condition and that those before it failed; afterwards holds what all branches leave."""
    checked: list[tuple[ir.Expr, stmt.Block, Span]] = []
    poisoned, ends = c.poisoned, []
    outer = c.flow
    for branch in node.branches:
        held = condition(branch.condition, c, "the condition of 'if'")
        before = c.flow
        known: linear.Formula = linear.UNKNOWN
        if before is not None and held.type == BOOL:
            known = formula(held, before)
            c.flow = before.knowing(known)
            if not c.poisoned and known != linear.UNKNOWN and _impossible(before, known):
                c.warn(
                    "K043", f"this branch can never run: {c.text(branch.condition.span)} never holds here", branch.span
                )
        c.poisoned = poisoned or held.type == POISON
        block = check_block(branch.block, c)
        ends.append(c.flow)
        checked.append((held, block, branch.span))
        c.flow = before.knowing(linear.negate(known)) if before is not None else None
        c.poisoned = c.poisoned or held.type == POISON
    orelse = check_block(node.orelse, c)
    ends.append(c.flow)
    c.poisoned = poisoned
    c.flow = _joined(ends) if outer is not None else None
    if any(held.type == POISON for held, _, _ in checked):
        return None
    result: stmt.Stmt | None = None
    for held, block, span in reversed(checked):
        result = stmt.If(held, block, orelse if result is None else (result,), span)
    return result


def _impossible(before: Flow, condition: linear.Formula) -> bool:
    return unsat((*relevant(before.facts, condition), condition))


def _joined(ends: list[Flow | None]) -> Flow | None:
    result: Flow | None = None
    for end in ends:
        if end is not None:
            result = end if result is None else result.joined(end)
    return result
