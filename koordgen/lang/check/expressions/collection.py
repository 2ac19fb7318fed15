"""Checks of displays (`[a]`), indices, slices, `in`, quantifiers, and the domains of loops and quantifiers."""

from __future__ import annotations

from koordgen.lang.check.base import (
    check_expr,
    condition,
    converted,
    converted_argument,
    is_display,
    is_poisoned,
    report_missing_index,
    same_type,
    widened,
    with_article,
)
from koordgen.lang.check.context import Context, Temp
from koordgen.lang.check.expressions.name import declared_port, import_named, module_named, report_shared_in_init
from koordgen.lang.check.names import is_reserved
from koordgen.lang.diagnostics import Label
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.decl import Local, Module, Shared
from koordgen.lang.ir.types import (
    BALL,
    BOOL,
    FLOAT,
    INT,
    POINT,
    POISON,
    RECT,
    SHARED_ELEMENTS,
    STRING,
    MapOf,
    PerRobot,
    Sequence,
    TupleOf,
    Type,
    is_key,
    list_of,
)
from koordgen.lang.source import Span
from koordgen.lang.syntax import expr as ast

_INTS = list_of(INT)


# Displays: `[a]`, `{a}`, `{a: b}`, `(a, b)`


def check_list(node: ast.ListDisplay, c: Context, wanted: Type | None = None) -> ir.Expr:
    """Check `[a, b]`: it is a List, or a Queue or Set if the context expects a Queue or Set."""
    name = wanted.name if isinstance(wanted, Sequence) else "List"
    element = wanted.element if isinstance(wanted, (Sequence, PerRobot)) else None
    if not node.items and element is None:
        return _empty(node, "[]", "List<Point>", c, wanted)
    return _sequence(name, node.items, element, node.span, c)


def check_set(node: ast.SetDisplay, c: Context, wanted: Type | None = None) -> ir.Expr:
    """Check `{a, b}`, which is a Set."""
    element = wanted.element if isinstance(wanted, Sequence) and wanted.name == "Set" else None
    made = _sequence("Set", node.items, element, node.span, c)
    if isinstance(made.type, Sequence) and not is_key(made.type.element):
        return _no_key(made.type.element, "an element of a Set", node.items[0].span, c)
    return made


def check_map(node: ast.MapDisplay, c: Context, wanted: Type | None = None) -> ir.Expr:
    """Check `{k: v}`, which is a Map, and `{}`, which is an empty Map or Set as the context expects."""
    if not node.items and isinstance(wanted, Sequence) and wanted.name == "Set":
        return ir.Make((), wanted, node.span)
    kinds: list[Type | None] = [wanted.key, wanted.value] if isinstance(wanted, MapOf) else [None, None]
    if not node.items and kinds[0] is None:
        return _empty(node, "{}", "Map<string, int>", c, wanted)
    keys = _items(tuple([k for k, _ in node.items]), kinds[0], "a key", c)
    values = _items(tuple([v for _, v in node.items]), kinds[1], "a value", c)
    if is_poisoned(keys) or is_poisoned(values):
        return c.poison(node.span, *keys, *values)
    key = kinds[0] or keys[0].type
    value = kinds[1] or values[0].type
    if not is_key(key):
        return _no_key(key, "the key of a Map", node.items[0][0].span, c)
    both = TupleOf((key, value))
    pairs = tuple([ir.Make((k, v), both, k.span) for k, v in zip(keys, values, strict=True)])
    return ir.Make(pairs, MapOf(key, value, SHARED_ELEMENTS), node.span)


def check_tuple(node: ast.Tuple, c: Context, wanted: Type | None = None) -> ir.Expr:
    """Check `(a, b)`, which is a tuple."""
    parts: tuple[Type | None, ...] = (None,) * len(node.items)
    if isinstance(wanted, TupleOf) and len(wanted.items) == len(node.items):
        parts = wanted.items
    items = []
    for item, part in zip(node.items, parts, strict=True):
        value = check_expr(item, c, part)
        items.append(_single(widened(value, part) if part is not None else value, c))
    if is_poisoned(items):
        return c.poison(node.span, *items)
    return ir.Make(tuple(items), TupleOf(tuple([item.type for item in items])), node.span)


def _sequence(name: str, nodes: tuple[ast.Expr, ...], element: Type | None, span: Span, c: Context) -> ir.Expr:
    items = _items(nodes, element, f"an element of this {name}", c)
    if element is POISON or is_poisoned(items):
        return c.poison(span, *items)
    return ir.Make(tuple(items), Sequence(name, element or items[0].type, SHARED_ELEMENTS), span)


def _items(nodes: tuple[ast.Expr, ...], type_: Type | None, what: str, c: Context) -> list[ir.Expr]:
    """Return the items of a display, all of one type: `type_`, or else the type of the first item.

    If an item is a float, int items are converted to floats. Wrong items become poison.
    """
    if type_ is not None:
        return [converted(check_expr(node, c, type_), type_, what, c) for node in nodes]
    typed = next((node for node in nodes if not is_display(node)), nodes[0])
    first = _single(check_expr(typed, c), c)
    checked = [first if node is typed else _single(check_expr(node, c, first.type), c) for node in nodes]
    if is_poisoned(checked):
        return checked
    common = FLOAT if first.type is INT and any(item.type is FLOAT for item in checked) else first.type
    checked = [widened(item, common) for item in checked]
    for item in checked:
        if not same_type(item.type, common):
            message = (
                f"this is {with_article(item.type)}, and the first is {with_article(common)}: all must be of one type"
            )
            return [c.error("K012", message, item.span, "", (Label(first.span, f"{with_article(common)}"),), *checked)]
    return checked


def _single(value: ir.Expr, c: Context) -> ir.Expr:
    """Return a value that becomes a part of a list, a tuple or the like.

    An allread variable without an index cannot be a part: it is reported and becomes poison."""
    return report_missing_index(value, c) if isinstance(value.type, PerRobot) else value


def _empty(node: ast.Expr, text: str, example: str, c: Context, wanted: Type | None) -> ir.Expr:
    if wanted is POISON:
        return c.poison(node.span)
    if wanted is not None:
        return c.error("K012", f"{with_article(wanted)} is expected here, not {text}", node.span)
    help = f"declare its type: '{example} name = {text}'"
    return c.error("K051", f"nothing here determines the type of {text}", node.span, help)


def _no_key(type_: Type, what: str, span: Span, c: Context) -> ir.Expr:
    return c.error(
        "K052",
        f"{with_article(type_)} cannot be {what}",
        span,
        "use an int, a bool, a string, or a tuple of these types",
    )


# Indices and slices: `xs[i]`, `xs[a:b]`


def check_index(node: ast.Index, c: Context, wanted: Type | None = None) -> ir.Expr:
    value = node.value
    if type(value) is ast.Name and c.temp(value.name) is None:
        entity = c.entities.get(value.name)
        if type(entity) is Shared and entity.kind == "allread":
            return _slot(node, entity, c)
        if type(entity) is Local and c.place == "property":
            index = robot_index(node.index, c)
            return index if index.type is POISON else ir.LocalOf(entity.name, index, entity.type, node.span)
    elif type(value) is ast.Attribute and c.place == "property":
        module = module_named(value.value, c)
        if module is not None:
            return _port_of(node, value, c)
        imported = import_named(value.value, c)
        if imported is not None and value.name == "pid":
            index = robot_index(node.index, c)
            return index if index.type is POISON else ir.LocalOf(imported.pid, index, INT, node.span)
    operand = check_expr(value, c)
    index = check_expr(node.index, c)
    if operand.type is POISON or index.type is POISON:
        return c.poison(node.span, operand, index)
    return element(operand, index, node, c)


def robot_index(node: ast.Expr, c: Context) -> ir.Expr:
    """Check the index of a robot in a property."""
    return converted(check_expr(node, c), INT, "an index", c)


def _port_of(node: ast.Index, value: ast.Attribute, c: Context) -> ir.Expr:
    module = module_named(value.value, c)
    assert module is not None
    port = declared_port(module, value, c)
    index = robot_index(node.index, c)
    if port is None or index.type is POISON:
        return c.poison(node.span, index)
    if port.direction not in ("sensor", "actuator"):
        return c.error("K054", f"{module.name}.{port.name} has no value that a property can read", node.span)
    return ir.PortOf(module.name, port.name, index, port.type, node.span)


def _slot(node: ast.Index, entity: Shared, c: Context) -> ir.Expr:
    name = entity.name
    index = converted(check_expr(node.index, c), INT, "an index", c)
    if index.type is POISON or entity.type is POISON:
        return c.poison(node.span, index)
    match c.place:
        case "constant":
            message = f"an initial value cannot depend on the variable {name}"
            return c.error("K025", message, node.span, "set the variable in init")
        case "function" | "contract" | "assume":
            return check_expr(node.value, c)  # reports why this section cannot read the variable
        case "init" if not isinstance(index, ir.Pid):
            return report_shared_in_init(c.text(node.span), node.span, c)
    return ir.SlotRead(name, index, type(index) is ir.Pid, entity.type, node.span)


def element(operand: ir.Expr, index: ir.Expr, node: ast.Index, c: Context) -> ir.Expr:
    """Return the typed expression `operand[index]`."""
    match operand.type:
        case Sequence("List" | "Queue", element=type_) | PerRobot(type_):
            pass
        case MapOf(key, value):
            index = converted(index, key, "the key", c)
            if index.type is POISON:
                return c.poison(node.span, operand, index)
            return ir.Builtin("map_at", (operand, index), value, node.span)
        case TupleOf(items):
            return _item(operand, items, node, c)
        case other if other == STRING:
            type_ = STRING
        case other:
            return _no_index(operand, other, node, c)
    index = converted(index, INT, "an index", c)
    return index if index.type is POISON else ir.At(operand, index, False, type_, node.span)


def _item(operand: ir.Expr, items: tuple[Type, ...], node: ast.Index, c: Context) -> ir.Expr:
    match node.index:
        case ast.Literal(int(number)) if not isinstance(number, bool):
            if number < len(items):
                return ir.Item(operand, number, items[number], node.span)
            message = f"{c.text(node.value.span)} has {len(items)} items: the last is [{len(items) - 1}]"
            return c.error("K030", message, node.span)
        case _:
            help = f"write a number from 0 to {len(items) - 1} in the brackets"
            return c.error("K017", "the index of a tuple must be a literal number", node.index.span, help)


def _no_index(operand: ir.Expr, type_: Type, node: ast.Index, c: Context) -> ir.Expr:
    text = c.text(node.value.span)
    named = isinstance(operand, (ir.LocalRead, ir.SharedRead, ir.ParamRead, ir.PortRead))
    if named and not isinstance(type_, Sequence):
        return c.error("K017", f"{text} is one value and takes no index", node.span, _part_help(text, type_))
    return c.error("K017", f"{with_article(type_)} takes no index", node.span, _part_help(text, type_))


def _part_help(text: str, type_: Type) -> str:
    if type_ is POINT:
        return f"a Point's coordinates are {text}.x, {text}.y and {text}.z"
    return "a Set has no order; 'for x in s' iterates over it" if isinstance(type_, Sequence) else ""


def check_slice(node: ast.Slice, c: Context, wanted: Type | None = None) -> ir.Expr:
    operand = check_expr(node.value, c)
    ends = [converted(check_expr(e, c), INT, "an index", c) if e is not None else None for e in (node.start, node.stop)]
    parts = [operand, *(end for end in ends if end is not None)]
    if is_poisoned(parts):
        return c.poison(node.span, *parts)
    type_ = operand.type
    if not ((isinstance(type_, Sequence) and type_.name == "List") or type_ == STRING):
        return c.error("K017", f"{with_article(type_)} has no slices", node.span, "", (), *parts)
    return ir.Slice(operand, ends[0], ends[1], ends == [None, None], type_, node.span)


# Containment: `in` and `not in`


def check_containment(op: str, first: ast.Expr, second: ast.Expr, span: Span, c: Context) -> ir.Expr:
    """Check `item in values` and `item not in values`."""
    if is_display(second) and not is_display(first):
        item = check_expr(first, c)
        known = item.type is FLOAT or not second.items
        values = check_expr(second, c, list_of(item.type) if known else None)
    else:
        values = check_expr(second, c)
        item = check_expr(first, c, _element_type(values.type))
    if item.type is POISON or values.type is POISON:
        return c.poison(span, item, values)
    held = _element_type(values.type)
    if held is None:
        help = "compare the distance of the points" if values.type is POINT else ""
        return c.error(
            "K012", f"'{op}' does not apply to {with_article(values.type)}", values.span, help, (), item, values
        )
    if values.type == STRING or held is POINT or isinstance(values.type, MapOf):
        what = f"the value to look for in {with_article(values.type)}"
    else:
        what = f"an element of this {values.type.name if isinstance(values.type, Sequence) else 'variable'}"
    item = converted_argument(item, held, what, c)
    if item.type is POISON:
        return item
    found = ir.Contains(item, values, BOOL, span)
    return found if op == "in" else ir.Unary("not", found, BOOL, span)


def _element_type(type_: Type) -> Type | None:
    """Return the type that `x` must have in `x in value`; None if 'in' does not apply to the value."""
    match type_:
        case Sequence(element=held) | PerRobot(held) | MapOf(key=held):
            return held
        case _:
            return POINT if type_ is RECT or type_ is BALL else type_ if type_ == STRING else None


# Domains of loops and quantifiers


def check_domain(node: ast.Expr, c: Context) -> ir.Expr:
    """Check the domain of a loop or quantifier: `range(...)`, or a value with elements."""
    if isinstance(node, ast.Call) and isinstance(node.function, ast.Name) and node.function.name == "range":
        return _range(node, c)
    if isinstance(node, ast.Attribute) and node.name == "ID":
        imported = import_named(node.value, c)
        if imported is not None:
            size = check_expr(ast.Attribute(node.value, "N_SYS", node.name_span, node.span), c)
            return size if size.type is POISON else ir.Range(ir.Const(0, INT, node.span), size, 1, _INTS, node.span)
    values = check_expr(node, c)
    if values.type is POISON or isinstance(values.type, (Sequence, MapOf, PerRobot)):
        return values
    help = f"write range({c.text(node.span)})" if values.type is INT else ""
    return c.error("K012", f"{with_article(values.type)} has no elements to iterate over", node.span, help, (), values)


def elements(values: ir.Expr) -> Type:
    """Return the type of the elements over which a loop iterates."""
    match values.type:
        case Sequence(element=held) | PerRobot(held) | MapOf(key=held):
            return held
        case _:
            return POISON


def _range(node: ast.Call, c: Context) -> ir.Expr:
    if not 1 <= len(node.args) <= 3 or any(isinstance(arg, ast.Keyword) for arg in node.args):
        help = "range(stop), range(start, stop) or range(start, stop, step)"
        return c.error("K014", f"range takes 1 to 3 arguments, not {len(node.args)}", node.span, help)
    args = [converted(check_expr(arg, c), INT, "an argument of range", c) for arg in node.args]  # type: ignore[arg-type]
    if is_poisoned(args):
        return c.poison(node.span, *args)
    step = _step(args[2]) if len(args) == 3 else 1
    if not step:
        return c.error("K012", "the step of a range must be a literal number other than 0", args[2].span)
    start = args[0] if len(args) > 1 else ir.Const(0, INT, node.span)
    return ir.Range(start, args[1] if len(args) > 1 else args[0], step, _INTS, node.span)


def _step(node: ir.Expr) -> int:
    match node:
        case ir.Const(int(value)):
            return value
        case ir.Unary("-", ir.Const(int(value))):
            return -value
        case _:
            return 0


def check_quantified(node: ast.Quantified, c: Context, wanted: Type | None = None) -> ir.Expr:
    """Check a quantifier. A quantifier of several names becomes nested quantifiers over the same domain."""
    if c.place not in ("property", "contract", "assume", "guarantee", "provided") and c.entry is None:
        help = "use a loop in place of the quantifier: 'for i in ID:'"
        message = (
            f"'{node.kind}' is only allowed in properties, guarantees, contracts, provided ports and loop invariants"
        )
        return c.error("K054", message, node.span, help)
    domain = check_domain(node.domain, c)
    c.scopes.append({})
    temps = [declare(name.name, elements(domain), name.span, c) for name in node.names]
    body = condition(node.body, c, f"the formula of '{node.kind}'")
    c.scopes.pop()
    wrong = domain.type is POISON or body.type is POISON or None in temps
    for temp in reversed(temps):
        if temp is not None:
            body = ir.Quantified(node.kind, temp.unique, domain, body, BOOL, node.span)
    return c.poison(node.span, body) if wrong else body


def declare(name: str, type_: Type, span: Span, c: Context) -> Temp | None:
    """Declare a temp, a variable of a block, in the innermost block.

    If the name is declared already, reports this and returns None. Later uses of the name still have the new type,
    unless the name belongs to another temp. In a function a temp may have the name of a variable or module, because
    functions cannot read variables and modules.
    """
    temp = Temp(c.mint(name), type_, span)
    earlier, entity = c.temp(name), c.entities.get(name)
    unseen = bool(c.function) and isinstance(entity, (Local, Shared, Module))
    if earlier is None and (unseen or name not in c.entities) and not is_reserved(name):
        c.scopes[-1][name] = temp
        return temp
    first = earlier.span if earlier is not None else entity.span if entity is not None else None
    labels = (Label(first, "declared here first"),) if first is not None else ()
    what = "is declared already" if earlier is not None or name in c.entities else "is predefined"
    c.error("K011", f"{name} {what}", span, "choose another name", labels)
    if earlier is None:
        c.scopes[-1][name] = temp
    return None
