"""Checks of the declarations of records, params and variables.

All types are checked before all initial values, so that declarations may stand in any order.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, NamedTuple

from koordgen.lang.check.base import check_expr, converted, default
from koordgen.lang.check.context import Context
from koordgen.lang.check.names import enter, is_owner, unique
from koordgen.lang.check.types import dialect_element, is_fleet_size, resolve, with_capacities
from koordgen.lang.diagnostics import Edit
from koordgen.lang.ir import decl, expr
from koordgen.lang.ir.capacity import excess
from koordgen.lang.ir.types import POISON, ExternType, RecordType, Type
from koordgen.lang.node import replace
from koordgen.lang.source import Span
from koordgen.lang.syntax import decl as ast
from koordgen.lang.syntax import expr as tree
from koordgen.lang.syntax import types as written
from koordgen.lang.syntax.walk import nodes

Kind = Literal["allread", "allwrite", "local"]


def extern_types(sections: Iterable[ast.ExternType], c: Context) -> tuple[decl.ExternTypeDef, ...]:
    for node in sections:
        if is_owner(node.name, node, c):
            enter(node.name, node, decl.ExternTypeDef(node.name, node.span), c)
            c.types[node.name] = ExternType(node.name) if c.entities[node.name] is not None else None
    return tuple([decl.ExternTypeDef(node.name, node.span) for node in sections])


Fields = list[tuple[ast.Variable, Type]]
Records = list[tuple[ast.RecordDef, Fields, RecordType | None]]


def record_types(sections: list[ast.RecordDef], c: Context) -> Records:
    """Define the types of records.

    Returns the records; each record comes after the records that its fields contain. Wrong records have no type.
    """
    from koordgen.lang.check.graph import topological_order

    for node in sections:
        c.types[node.name] = None
    owned = {node.name: node for node in sections if is_owner(node.name, node, c)}
    order, cycles = topological_order({name: _field_type_names(node) for name, node in owned.items()})
    for cycle in cycles:
        way = f" (it holds {', which holds '.join([*cycle[1:], cycle[0]])})" if len(cycle) > 1 else ""
        help = "a record holds values, not references; use an index into a list instead"
        c.error("K055", f"the record {cycle[0]} contains itself{way}", owned[cycle[0]].span, help)
    inside = {name for cycle in cycles for name in cycle}
    sizes: dict[str, tuple[int, int]] = {}
    records: Records = []
    for node in [*(owned[name] for name in order), *(n for n in sections if not is_owner(n.name, n, c))]:
        fields, type_ = _record_type(node, sizes, c)
        type_ = None if node.name in inside else type_
        records.append((node, fields, type_))
        enter(node.name, node, decl.Record(type_, (), node.span) if type_ else None, c)
        if owned.get(node.name) is node and c.entities[node.name] is not None:
            c.types[node.name] = type_
    return records


_MOST_PARTS, _DEEPEST = 1000, 20  # limits on the fields and the nesting of a record, including the records in it


def _field_type_names(node: ast.RecordDef) -> list[str]:
    return [part.name for field in node.fields for part in nodes(field.type) if isinstance(part, written.NamedType)]


def _record_type(
    node: ast.RecordDef, sizes: dict[str, tuple[int, int]], c: Context
) -> tuple[Fields, RecordType | None]:
    fields: Fields = []
    seen: dict[str, Span] = {}
    for field in node.fields:
        if isinstance(field.type, written.BrokenType):
            fields.append((field, POISON))  # the field's name is only the parser's guess
            continue
        type_ = with_capacities(resolve(field.type, c), field.capacities, False, c)
        type_ = POISON if _has_size(field, "in a record", c) else type_
        if unique(field.name, f"fields of {node.name}", field.span, seen, c):
            fields.append((field, type_))
    inner = [sizes[name] for name in _field_type_names(node) if name in sizes]
    parts, depth = len(fields) + sum(p for p, _ in inner), 1 + max((d for _, d in inner), default=0)
    sizes[node.name] = parts, depth
    if parts > _MOST_PARTS or depth > _DEEPEST:
        much = f"more than {_MOST_PARTS} parts" if parts > _MOST_PARTS else f"records more than {_DEEPEST} deep"
        c.error("K007", f"the record {node.name} holds {much}", node.span, "split the record into several records")
        return fields, None
    if any(type_ is POISON for _, type_ in fields):
        return fields, None
    return fields, RecordType(node.name, tuple([(field.name, type_) for field, type_ in fields]))


def record_defaults(found: Records, c: Context) -> tuple[decl.Record, ...]:
    """Return the records with the initial values of their fields, in the order of `found`."""
    records = []
    for node, fields, type_ in found:
        defaults = [_initial(field, field.initial, held, c, _NO_PARAM_IN_FIELD) for field, held in fields]
        if type_ is not None:
            records.append(decl.Record(type_, tuple(defaults), node.span))
            enter(node.name, node, records[-1], c)
    return tuple(records)


_NO_PARAM_IN_FIELD = "a field's initial value cannot depend on a param"
_NO_PARAM_IN_PARAM = "a param's default cannot depend on another param"


def param_types(sections: list[ast.Param], c: Context) -> None:
    for node in sections:
        type_ = with_capacities(resolve(node.type, c), node.capacities, True, c)
        blank = c.poison(node.span)
        enter(node.name, node, None if type_ is POISON else decl.Param(node.name, type_, blank, node.span), c)


def param_defaults(sections: list[ast.Param], c: Context) -> tuple[decl.Param, ...]:
    params = []
    for node in sections:
        entity = c.entities.get(node.name)
        type_ = entity.type if isinstance(entity, decl.Param) and is_owner(node.name, node, c) else POISON
        value = _initial(node, node.default, type_, c, _NO_PARAM_IN_PARAM)
        param = decl.Param(node.name, type_, value, node.span)
        params.append(param)
        if type_ is not POISON:
            enter(node.name, node, param, c)
    return tuple(params)


class ImportedNames(NamedTuple):
    """Imports of a program, and the declarations that they add to it."""

    imports: tuple[decl.Import, ...] = ()
    shared: tuple[decl.Shared, ...] = ()
    specs: tuple[decl.SpecFunction, ...] = ()
    sizes: tuple[decl.Param, ...] = ()  # the numbers of the exporters' members
    pids: tuple[decl.Local, ...] = ()  # this robot's place among the exporters' members


TypedVariables = list[tuple[ast.Variable, Kind, Type]]


def variable_types(sections: Iterable[ast.Variables], c: Context) -> TypedVariables:
    """Define the variables, without their initial values."""
    typed: TypedVariables = []
    for section in sections:
        kind = section.kind
        for node in section.variables:
            if isinstance(node.type, written.BrokenType):
                continue  # the variable's name is only the parser's guess
            type_ = _variable_type(node, kind, c)
            typed.append((node, kind, type_))
            if type_ is POISON:
                enter(node.name, node, None, c)
            elif kind == "local":
                enter(node.name, node, decl.Local(node.name, type_, c.poison(node.span), node.span), c)
            else:
                enter(node.name, node, decl.Shared(node.name, kind, type_, c.poison(node.span), node.span), c)
    return typed


def _variable_type(node: ast.Variable, kind: Kind, c: Context) -> Type:
    type_ = node.type
    if kind != "allread":
        if _has_size(node, f"under '{kind}:'", c):
            resolve(type_, c)
            return POISON  # a use of the variable with an index would be a further error if the variable had a type
    elif node.size is not None:
        if not is_fleet_size(node.size, c) and not isinstance(node.size, tree.Broken):
            _not_per_robot(node, node.size.span, c)
    elif isinstance(type_, written.GenericType) and type_.name == "[]":
        element = dialect_element(type_.args[0], c)
        new = f"{element} {node.name}[N_SYS]"
        place = Span(type_.span.line, type_.span.column, node.span.end_line, node.span.end_column)
        if element is not POISON:
            c.report_old_spelling(c.text(place), new, place, (Edit(place, new),))
        return with_capacities(element, node.capacities, False, c)
    else:
        _not_per_robot(node, node.span, c)
    return with_capacities(resolve(type_, c), node.capacities, kind == "local", c)


def _not_per_robot(node: ast.Variable, span: Span, c: Context) -> None:
    message = f"an allread variable has one value for each robot: {node.name}[N_SYS]"
    c.error("K017", message, span, f"write {c.text(node.type.span)} {node.name}[N_SYS]")


def _has_size(node: ast.Variable, where: str, c: Context) -> bool:
    """Return whether a variable that cannot have a size is declared with a size, and report that."""
    if node.size is not None and not isinstance(node.size, tree.Broken):
        help = f"write List<{c.text(node.type.span)}> {node.name}"
        c.error("K017", f"an array {where} is a list: {node.name} takes no size", node.size.span, help)
    return node.size is not None


def variable_initials(
    typed: TypedVariables, imported: ImportedNames, c: Context
) -> tuple[tuple[decl.Shared, ...], tuple[decl.Local, ...]]:
    """Return all shared and local variables with their initial values, those of imports last.

    The value of an imported variable comes from the exporter, so here it has the default value of its type.
    """
    shared: list[decl.Shared] = []
    locals_: list[decl.Local] = []
    for node, kind, type_ in typed:
        initial = _initial(node, node.initial, type_, c)
        if kind == "local":
            locals_.append(decl.Local(node.name, type_, initial, node.span))
        else:
            shared.append(decl.Shared(node.name, kind, type_, initial, node.span))
    shared += [replace(v, initial=default(v.type, v.span, c)) for v in imported.shared]
    return tuple(shared), (*locals_, *imported.pids)


def _initial(
    node: ast.Variable | ast.Param, value: tree.Expr | None, type_: Type, c: Context, no_params: str = ""
) -> expr.Expr:
    """Check an initial value.

    An initial value may use literals, builtin functions and params. If `no_params` is not empty, params are
    not allowed, and `no_params` is the message that reports a param.
    """
    if value is None:
        return c.poison(node.span) if type_ is POISON else default(type_, node.span, c)
    c.enter("constant")
    if no_params and not isinstance(value, tree.Literal):
        for part in nodes(value):
            if isinstance(part, tree.Name) and isinstance(c.entities.get(part.name), decl.Param):
                return c.error("K025", no_params, part.span)
    initial = converted(check_expr(value, c, type_), type_, node.name, c)
    too_much = excess(initial, type_)
    if too_much:
        help = "declare a larger capacity with 'max'"
        return c.error("K053", f"the initial value of {node.name} has {too_much}", value.span, help, (), initial)
    return initial
