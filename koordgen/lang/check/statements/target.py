"""Checks of the targets of assignments and of updating methods: a variable, or a part of its value.

An assignment to a part, such as `p.x = 1`, becomes an assignment of the whole value with that part replaced.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeGuard

from koordgen.lang.check.base import check_expr, converted, converted_argument, has_call, is_poisoned, with_article
from koordgen.lang.check.context import PREDEFINED, Context
from koordgen.lang.check.expressions.call import checked_arguments, positional_arguments, report_no_method
from koordgen.lang.check.expressions.collection import element
from koordgen.lang.check.expressions.name import (
    FOREIGN,
    declared_port,
    field_of,
    module_named,
    reject_robot_state,
    report_ended,
    report_no_field,
    type_word,
)
from koordgen.lang.diagnostics import Label
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir import stmt
from koordgen.lang.ir.builtins import UPDATES
from koordgen.lang.ir.decl import (
    ExternFunction,
    ExternTypeDef,
    Function,
    Import,
    Local,
    Module,
    Param,
    Record,
    Shared,
    SpecFunction,
)
from koordgen.lang.ir.draft import SlotPlace
from koordgen.lang.ir.types import INT, POINT, POISON, MapOf, RecordType, Sequence, TupleOf, Type, list_of
from koordgen.lang.node import Node
from koordgen.lang.syntax import expr as ast


class AssignmentTarget(Node):
    """Target of an assignment: a variable, or a part of its value.

    `read` is the expression that reads the target, and `place` is the whole variable. To assign `new` to the target,
    the variable is set to `put(new)`. `whole` is True if the target is the variable itself; `put(new)` is then `new`.
    """

    place: stmt.Place | SlotPlace
    read: ir.Expr
    put: Callable[[ir.Expr], ir.Expr]
    whole: bool


def check_target(node: ast.Expr, c: Context) -> AssignmentTarget | None:
    """Return the target of an assignment. Report an expression that cannot be assigned, and return None."""
    match node:
        case ast.Name():
            return _named(node, c)
        case ast.Index(value, _):
            if isinstance(value, ast.Name) and c.temp(value.name) is None:
                entity = c.entities.get(value.name)
                if isinstance(entity, Shared) and entity.kind == "allread":
                    return _slot(node, entity, c)
            outer = check_target(value, c)
            return None if outer is None else _element(outer, node, c)
        case ast.Attribute(value, _):
            module = module_named(value, c)
            if module is not None:
                return _port(module, node, c)
            if isinstance(value, (ast.Call, ast.Slice)):
                _no_target(node, c)
                return None
            outer = check_target(value, c)
            return None if outer is None else _field(outer, node, c)
        case _:
            _no_target(node, c)
            return None


def _no_target(node: ast.Expr, c: Context) -> None:
    if check_expr(node, c).type is not POISON:
        help = "assign its elements one by one in a loop" if isinstance(node, ast.Slice) else ""
        if isinstance(node, ast.Tuple):
            help = "assign each variable on a line of its own"
        c.error("K022", f"{c.text(node.span)} cannot be assigned", node.span, help)


def _same(value: ir.Expr) -> ir.Expr:
    return value


def _named(node: ast.Name, c: Context) -> AssignmentTarget | None:
    name, span = node.name, node.span
    temp = c.temp(name)
    if temp is not None:
        return AssignmentTarget(stmt.TempPlace(temp.unique), ir.TempRead(temp.unique, temp.type, span), _same, True)
    if name not in c.entities:
        _unknown(node, c)
        return None
    match c.entities[name]:
        case None:
            pass
        case Local(type=type_):
            if reject_robot_state("the variable ", name, span, c) is None:
                return AssignmentTarget(stmt.LocalPlace(name), ir.LocalRead(name, type_, span), _same, True)
        case Shared(kind="allwrite") if name in c.imported and name not in c.imported[name].written:
            _read_only(node, c)
        case Shared(kind="allwrite", type=type_):
            if reject_robot_state("the variable ", name, span, c) is None:
                return AssignmentTarget(stmt.SharedPlace(name), ir.SharedRead(name, type_, span), _same, True)
        case Shared():
            c.error("K017", f"{name} has a value for each robot and needs an index", span, f"write {name}[pid] = ...")
        case Param():
            c.error("K022", f"{name} is a param and cannot be assigned", span, "declare a variable under 'local:'")
        case Import():
            c.error("K022", f"{name} is an import and cannot be assigned", span)
        case Module():
            c.error("K022", f"{name} is a module and cannot be assigned", span)
        case Function() | ExternFunction() | SpecFunction():
            c.error("K022", f"{name} is a function and cannot be assigned", span)
        case Record() | ExternTypeDef():
            c.error("K022", f"{name} is a type and cannot be assigned", span)
    return None


def _read_only(node: ast.Name, c: Context) -> None:
    """Report a write to a variable that is imported without `write`."""
    name, imported = node.name, c.imported[node.name]
    entity = c.entities[name]
    labels = (Label(entity.span, "imported here"),) if entity is not None else ()
    if name in imported.slots:
        message = f"{name} belongs to the robots that run {imported.name} and cannot be written here"
        c.error("K060", message, node.span, "", labels)
        return
    help = f"write 'write {{}} {name}' under 'import {imported.name}:'; the exporter must allow it"
    type_ = entity.type if isinstance(entity, Shared) else ""
    c.error("K060", f"{name} is imported without 'write'", node.span, help.format(type_), labels)


def _unknown(node: ast.Name, c: Context) -> None:
    name, span = node.name, node.span
    if name in PREDEFINED:
        c.error("K022", f"{name} is predefined and cannot be assigned", span)
    elif name not in c.broken and name not in c.owners:
        c.owners[name] = node  # treat the assignment as a declaration, so that later uses are not reported
        if not report_ended(name, span, c):
            help = FOREIGN.get(name) or c.suggestion(name, [n for n in c.visible_names() if n not in PREDEFINED])
            c.error("K010", f"{name} is not defined", span, help or declaration(name))


def declaration(name: str, type_: str = "Type", value: str = "...") -> str:
    """Return the help for an assignment to an undeclared variable: the text of a declaration."""
    return f"declare {name}: '{type_} {name} = {value}'"


def _slot(node: ast.Index, entity: Shared, c: Context) -> AssignmentTarget | None:
    index = converted(check_expr(node.index, c), INT, "an index", c)
    if index.type is POISON or entity.type is POISON:
        return None
    name = entity.name
    if reject_robot_state("the variable ", name, node.value.span, c) is not None:
        return None
    read = ir.SlotRead(name, ir.Pid(INT, index.span), True, entity.type, node.span)
    place = stmt.OwnSlot(name) if type(index) is ir.Pid else SlotPlace(name, index, node.span)
    return AssignmentTarget(place, read, _same, True)


def _port(module: Module, node: ast.Attribute, c: Context) -> AssignmentTarget | None:
    port = declared_port(module, node, c)
    name = f"{module.name}.{node.name}"
    if port is None or reject_robot_state("the port ", name, node.span, c) is not None:
        return None
    if port.direction == "actuator":
        read = ir.PortRead(module.name, port.name, False, port.type, node.span)
        return AssignmentTarget(stmt.PortPlace(module.name, port.name), read, _same, True)
    if port.direction == "sensor":
        label = Label(port.span, "declared as a sensor")
        c.error("K020", f"{name} is a sensor and cannot be assigned", node.span, labels=(label,))
    elif port.direction == "stream":
        c.error("K056", f"{name} is a stream and cannot be assigned", node.span, f"write {name} << ...")
    else:
        c.error("K022", f"{name} is a callable port and cannot be assigned", node.span)
    return None


def _element(outer: AssignmentTarget, node: ast.Index, c: Context) -> AssignmentTarget | None:
    """Return the target `outer[index]`, where `outer` is a List, a Map or a tuple."""
    read, type_ = outer.read, outer.read.type
    if type_ is POISON:
        return None
    if isinstance(type_, TupleOf):
        item = element(read, c.poison(node.index.span), node, c)
        if not isinstance(item, ir.Item):
            return None
        return _part(outer, item, lambda new: ir.With(read, str(item.index), new, type_, node.span))
    index = check_expr(node.index, c)
    if index.type is POISON:
        return None
    if isinstance(type_, MapOf):
        key = hoisted(converted(index, type_.key, "the key", c), c)
        if key.type is POISON:
            return None
        at = ir.Builtin("map_at", (read, key), type_.value, node.span)
        return _part(outer, at, lambda new: ir.Builtin("map_with", (read, key, new), type_, node.span))
    if isinstance(type_, Sequence) and type_.name == "List":
        found = element(read, hoisted(index, c), node, c)
        if not isinstance(found, ir.At):
            return None
        return _part(outer, found, lambda new: ir.Builtin("updated", (read, found.index, new), type_, node.span))
    part = element(read, index, node, c)
    if part.type is not POISON:
        message = f"{c.text(node.span)} is a part of {with_article(type_)} and cannot be assigned"
        c.error("K022", message, node.span, "assign the whole value")
    return None


def _field(outer: AssignmentTarget, node: ast.Attribute, c: Context) -> AssignmentTarget | None:
    """Return the target `outer.name`, where `outer` is a record."""
    read, type_ = outer.read, outer.read.type
    if type_ is POISON:
        return None
    field = field_of(type_, node.name)
    if field is None:
        report_no_field(read, node, c)
        return None
    if not isinstance(type_, RecordType):
        help = "assign a whole Point: p = Point(x, y, z)" if type_ is POINT else f"assign a whole {type_}"
        c.error("K022", f"{c.text(node.span)} is a part of a value and cannot be assigned", node.span, help)
        return None
    part = ir.Field(read, node.name, field, node.span)
    return _part(outer, part, lambda new: ir.With(read, node.name, new, type_, node.span))


def _part(outer: AssignmentTarget, read: ir.Expr, put: Callable[[ir.Expr], ir.Expr]) -> AssignmentTarget:
    return AssignmentTarget(outer.place, read, lambda new: outer.put(put(new)), False)


def hoisted(index: ir.Expr, c: Context) -> ir.Expr:
    """Return an index that can be evaluated twice with the same value.

    If the index contains a call, its value is saved in a temp, a variable declared before the statement.
    """
    if not has_call(index):
        return index
    name = c.mint("index")
    c.hoisted.append(stmt.Let(name, index.type, index, index.span))
    return ir.TempRead(name, index.type, index.span)


# Methods that change their object: `xs.append(v)` assigns to `xs` a list with one more element.

Update = tuple[AssignmentTarget, ir.Expr | None, ir.Expr]  # (changed target, result of `pop` or None, new value)
_NAMES = {name for _, name in UPDATES} | {"pop"}


def is_update(node: ast.Expr | None, c: Context) -> TypeGuard[ast.Call]:
    """Return whether an expression is a call of a method that changes its object."""
    return (
        type(node) is ast.Call
        and type(node.function) is ast.Attribute
        and node.function.name in _NAMES
        and module_named(node.function.value, c) is None
    )


def is_pop(node: ast.Expr | None, c: Context) -> TypeGuard[ast.Call]:
    """Return whether an expression is a call of `pop`, which changes its object and has a value."""
    return is_update(node, c) and isinstance(node.function, ast.Attribute) and node.function.name == "pop"


def check_update(node: ast.Call, c: Context) -> Update | None:
    """Return the target, the result and the new value of a call of an updating method: `xs.append(1)`.

    Reports a wrong call and returns None."""
    function = node.function
    assert isinstance(function, ast.Attribute)
    target = check_target(function.value, c)
    if target is None or target.read.type is POISON:
        checked_arguments(node, c)
        return None
    type_, name = target.read.type, function.name
    word = type_word(type_)
    if name == "pop" and word in ("List", "Queue"):
        return _pop(target, node, c)
    update = UPDATES.get((word, name))
    if update is None:
        checked_arguments(node, c)
        report_no_method(target.read, function, c)
        return None
    types = _arguments(type_, name)
    usage = f"{name} takes ({', '.join(map(str, types))})"
    nodes = positional_arguments(node, name, (len(types),), usage, c)
    if not isinstance(nodes, tuple):
        return None
    args = [
        converted_argument(check_expr(arg, c, wanted), wanted, f"an argument of {name}", c)
        for arg, wanted in zip(nodes, types, strict=True)
    ]
    if is_poisoned(args):
        return None
    return target, None, ir.Builtin(update, (target.read, *args), type_, node.span)


def _arguments(type_: Type, name: str) -> tuple[Type, ...]:
    """Return the types of the parameters of an updating method."""
    if name == "clear":
        return ()
    if isinstance(type_, MapOf):
        return (type_.key,)
    assert isinstance(type_, Sequence)
    if name == "extend":
        return (list_of(type_.element),)
    return (INT, type_.element) if name == "insert" else (type_.element,)


def _pop(target: AssignmentTarget, node: ast.Call, c: Context) -> Update | None:
    read, type_, span = target.read, target.read.type, node.span
    assert isinstance(type_, Sequence)
    many = (0,) if type_.name == "Queue" else (0, 1)
    help = (
        "pop() removes the front of a Queue"
        if type_.name == "Queue"
        else "pop() removes the last element, pop(i) the element at index i"
    )
    nodes = positional_arguments(node, "pop", many, help, c)
    if not isinstance(nodes, tuple):
        return None
    if type_.name == "Queue":
        rest = ir.Builtin("without", (read, ir.Const(0, INT, span)), type_, span)
        return target, ir.Builtin("first", (read,), type_.element, span), rest
    if not nodes:
        last = ir.Binary("-", ir.Builtin("len", (read,), INT, span), ir.Const(1, INT, span), True, INT, span)
        value = ir.At(read, last, False, type_.element, span)
        return target, value, ir.Builtin("popped", (read,), type_, span)
    index = hoisted(converted(check_expr(nodes[0], c), INT, "an index", c), c)
    if index.type is POISON:
        return None
    return target, ir.At(read, index, False, type_.element, span), ir.Builtin("without", (read, index), type_, span)
