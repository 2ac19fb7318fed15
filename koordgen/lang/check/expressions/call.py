"""Calls of builtins, methods, functions, extern functions, callable ports and records."""

from __future__ import annotations

from collections.abc import Sequence as Many

from koordgen.lang.check.base import (
    check_expr,
    converted,
    converted_argument,
    is_poisoned,
    same_type,
    widened,
    with_article,
)
from koordgen.lang.check.context import Context
from koordgen.lang.check.expressions.dialect import FUNCTIONS as OLD_FUNCTIONS
from koordgen.lang.check.expressions.dialect import old_call
from koordgen.lang.check.expressions.name import (
    HABITS,
    NO_FUNCTIONS,
    assumed_port,
    declared_port,
    field_of,
    is_event,
    methods_of,
    module_named,
    names_a_value,
    report_not_called,
    type_word,
)
from koordgen.lang.check.invariant import check_old, report_port_call
from koordgen.lang.ir import decl
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.builtins import FUNCTIONS, METHODS, ORDERED, UPDATES, VARIABLES, K, N, Signature
from koordgen.lang.ir.types import (
    FLOAT,
    GRID,
    INT,
    NAMED,
    PLANNER,
    POINT,
    POISON,
    SHARED_ELEMENTS,
    STRING,
    MapOf,
    PerRobot,
    RecordType,
    Scalar,
    Sequence,
    TupleOf,
    Type,
    is_key,
    list_of,
)
from koordgen.lang.node import replace
from koordgen.lang.source import Span
from koordgen.lang.syntax import expr as ast

_LENGTHS = ("length", "size", "len", "__len__")
_PATH = list_of(POINT)
_OBSTACLES = (list_of(GRID), _PATH)


def check_call(node: ast.Call, c: Context, wanted: Type | None = None) -> ir.Expr:
    function = node.function
    if type(function) is ast.Attribute:
        module = module_named(function.value, c)
        return _method(node, function, c) if module is None else _port_call(node, module, function, c)
    if type(function) is not ast.Name:
        called = check_expr(function, c)
        args = checked_arguments(node, c)
        if called.type is POISON:
            return c.poison(node.span, called, *args)
        return c.error("K017", "this is not a function", function.span, "", (), called, *args)
    name = function.name
    if c.temp(name) is not None:
        return _not_a_function(node, function, c)
    owner = assumed_port(name, c) if c.place == "assume" else None
    if owner is not None:
        return _port_call(node, owner, ast.Attribute(function, name, function.span, function.span), c)
    if name in c.entities:
        return _declared_call(node, function, c)
    if name in FUNCTIONS:
        return _builtin(name, node, c)
    if name == "old":
        return check_old(node, c)
    if name in OLD_FUNCTIONS:
        modern = old_call(node, function, c)
        if modern is not None:
            return check_expr(modern, c, wanted)
    return _not_a_function(node, function, c)


def _declared_call(node: ast.Call, function: ast.Name, c: Context) -> ir.Expr:
    entity = c.entities[function.name]
    match entity:
        case None:
            return c.poison(node.span, *checked_arguments(node, c))
        case decl.Record():
            return _record(entity, node, c)
        case decl.Function() | decl.ExternFunction() | decl.SpecFunction():
            return _function(entity, node, function, c)
        case _:
            return _not_a_function(node, function, c)


def checked_arguments(node: ast.Call, c: Context) -> tuple[ir.Expr, ...]:
    """Check and return the arguments of a wrong call, so that errors within the arguments are reported, too."""
    checked = []
    for arg in node.args:
        value = arg.value if isinstance(arg, ast.Keyword) else arg
        if isinstance(value, (ast.ListDisplay, ast.MapDisplay)) and not value.items:
            continue
        if isinstance(value, ast.Name) and value.name in NAMED:
            continue  # for example isinstance(n, int)
        if isinstance(value, ast.Call) and isinstance(value.function, ast.Name) and value.function.name == "range":
            continue  # for example list(range(3))
        checked.append(check_expr(value, c))
    return tuple(checked)


def _not_a_function(node: ast.Call, function: ast.Name, c: Context) -> ir.Expr:
    name = function.name
    args = checked_arguments(node, c)
    if name == "range":
        help = "use range in a loop: 'for i in range(n):'"
        return c.error("K017", "range(...) is not a value", node.span, help, (), *args)
    if name in NO_FUNCTIONS and name not in c.entities and c.temp(name) is None:
        return c.error("K010", f"{name} is not a function of Koord", function.span, NO_FUNCTIONS[name], (), *args)
    if names_a_value(name, c):
        report_not_called(name, function.span, c)
        return c.poison(node.span, *args)
    if name in c.broken or name in c.owners:
        return c.poison(node.span, *args)
    if is_event(name, c):
        help = "a robot chooses its events by their guards; move code that several events share into a 'fun'"
        return c.error("K017", f"{name} is an event and is not called", function.span, help, (), *args)
    own = [n for n, e in c.entities.items() if isinstance(e, (decl.Function, decl.ExternFunction, decl.Record))]
    help = c.suggestion(
        name, [*own, *FUNCTIONS], {"dist": "distance", "length": "len", "size": "len", "norm": "distance"}
    )
    taken = "..." if node.args else ""
    define = f"define {name}: 'fun {name}({taken}) -> Type:', or in Python 'extern fun {name}({taken}) -> Type'"
    return c.error("K010", f"{name} is not defined", function.span, help or define, (), *args)


# Arguments


def positional_arguments(
    node: ast.Call, name: str, count: Many[int], usage: str, c: Context
) -> tuple[ast.Expr, ...] | ir.Expr:  # fmt: skip
    """Return the unchecked arguments of a call that takes no named arguments.

    If their number is wrong or an argument is named, reports this and returns poison. `count` has the allowed numbers.
    """
    for arg in node.args:
        if isinstance(arg, ast.Keyword):
            args = checked_arguments(node, c)
            help = "only the fields of a record can be given by name"
            return c.error("K014", f"{name} takes its arguments without names", arg.span, help, (), *args)
    if len(node.args) not in count:
        args = checked_arguments(node, c)
        plural = "" if count[-1] == 1 else "s"
        many = " or ".join(map(str, count)) if count[-1] else "no"
        message = f"{name} takes {many} argument{plural}, not {len(node.args)}"
        return c.error("K014", message, node.span, usage, (), *args)
    return node.args  # type: ignore[return-value]


def _converted_arguments(
    nodes: tuple[ast.Expr, ...], types: Many[Type], name: str, usage: str, c: Context
) -> tuple[ir.Expr, ...]:  # fmt: skip
    """Check arguments against the types of the parameters and return them; a wrong argument becomes poison."""
    args = []
    for node, type_ in zip(nodes, types, strict=True):
        value = check_expr(node, c, type_)
        before = len(c.found)
        args.append(converted_argument(value, type_, f"an argument of {name}", c))
        _add_help(before, usage, c)
    return tuple(args)


def _add_help(before: int, usage: str, c: Context) -> None:
    """Add the help `usage` to the diagnostics from index `before` on, except to those that have a help already."""
    for position in range(before, len(c.found)):
        if not c.found[position].help:
            c.found[position] = replace(c.found[position], help=usage)


# Builtins and methods


def _builtin(name: str, node: ast.Call, c: Context) -> ir.Expr:
    signatures = FUNCTIONS[name]
    usage = _TAKES.get(name) or f"{name} takes {' or '.join(shown(s) for s in signatures)}"
    nodes = positional_arguments(node, name, (len(signatures[0].args),), usage, c)
    if not isinstance(nodes, tuple):
        return nodes
    if len(signatures) == 1:
        return _applied(name, signatures[0], nodes, usage, node.span, c)
    arg = check_expr(nodes[0], c)
    if arg.type is POISON:
        return c.poison(node.span, arg)
    for signature in signatures:
        bound: Bound = {}
        value = match_argument(signature.args[0], arg, bound)
        if value is not None:
            result = substituted(signature.result, bound)
            assert result is not None
            return ir.Builtin(name, (value,), result, node.span)
    return c.error("K012", f"{name} does not apply to {with_article(arg.type)}", arg.span, usage, (), arg)


_TAKES = {
    "len": "len takes a List, Queue, Set, Map or string",
    "str": "str takes an int, float, bool, string or Point",
    "first": "first takes a List or Queue",
    "last": "last takes a List or Queue",
    "reversed": "reversed takes a List",
    "sorted": "sorted takes a List of ints, floats or strings",
    "min": "min takes two numbers; the least of a list is first(sorted(xs))",
    "max": "max takes two numbers; the greatest of a list is last(sorted(xs))",
}


def _applied(
    name: str, signature: Signature, nodes: tuple[ast.Expr, ...], usage: str, span: Span, c: Context,
    first: ir.Expr | None = None,
) -> ir.Expr:  # fmt: skip
    """Check a call of a builtin that has a single signature. For a method, `first` is the object."""
    bound: Bound = {}
    args: list[ir.Expr] = []
    poisoned = False
    patterns = signature.args
    if first is not None:
        args.append(match_argument(patterns[0], first, bound) or first)
        patterns = patterns[1:]
    for pattern, node in zip(patterns, nodes, strict=True):
        value = check_expr(node, c, substituted(pattern, bound))
        taken = value if value.type is POISON else match_argument(pattern, value, bound)
        args.append(value if taken is None else taken)
        poisoned = poisoned or taken is None or taken.type is POISON
        if taken is None:
            before = len(c.found)
            wanted = substituted(pattern, bound)
            if wanted is None:
                c.error("K012", f"{name} does not apply to {with_article(value.type)}", value.span, usage)
            else:
                converted(value, wanted, f"an argument of {name}", c)
            _add_help(before, usage, c)
    if poisoned:
        return c.poison(span, *args)
    result = substituted(signature.result, bound)
    assert result is not None
    if bound.get("N") is FLOAT:
        args = [widened(arg, FLOAT) for arg in args]
    return ir.Builtin(name, tuple(args), result, span)


def _method(node: ast.Call, function: ast.Attribute, c: Context) -> ir.Expr:
    if isinstance(function.value, ast.Name) and _is_unknown(function.value.name, c) and function.name in FUNCTIONS:
        args = checked_arguments(node, c)  # for example math.sqrt(2)
        message, help = f"{function.value.name} is not defined", f"write {function.name}(...)"
        return c.error("K010", message, function.value.span, help, (), *args)
    operand = check_expr(function.value, c)
    if operand.type is POISON:
        return c.poison(node.span, operand, *checked_arguments(node, c))
    type_, name = operand.type, function.name
    word = "List" if isinstance(type_, PerRobot) else type_word(type_)
    signature = METHODS.get((word, name))
    if signature is not None:
        nodes = positional_arguments(node, name, (len(signature.args) - 1,), "", c)
        usage = f"{name} takes {shown(signature, 1)}"
        if not isinstance(nodes, tuple):
            return c.poison(node.span, operand, nodes)
        return _applied(name, signature, nodes, usage, node.span, c, operand)
    parts = (operand, *checked_arguments(node, c))
    if (word, name) in UPDATES or (name == "pop" and word in ("List", "Queue")):
        text = c.text(function.value.span)
        help = f"write 'x = {text}.pop()', and use x" if name == "pop" else f"call {name} on a line of its own"
        message = f"{name} changes {text} and cannot be used within an expression"
        return c.error("K027", message, node.span, help, (), *parts)
    report_no_method(operand, function, c)
    return c.poison(node.span, *parts)


def _is_unknown(name: str, c: Context) -> bool:
    return c.temp(name) is None and not names_a_value(name, c) and name not in c.broken and name not in c.owners


def report_no_method(operand: ir.Expr, function: ast.Attribute, c: Context) -> None:
    """Report a call of a method that a value does not have, and suggest what to write."""
    type_, name, text = operand.type, function.name, c.text(function.value.span)
    word = type_word(type_)
    if field_of(type_, name) is not None:
        c.error("K017", f"{text}.{name} is a field and is not called", function.span)
        return
    if name in _LENGTHS and (isinstance(type_, (Sequence, MapOf, PerRobot)) or word == "string"):
        help = f"write len({text})"
    elif name in ("contains", "includes", "has", "has_key"):
        help = f"write x in {text}"
    elif name in HABITS.get(word, {}):
        help = f"write {text}.{HABITS[word][name]}(...)"
    elif name in ("sort", "reverse") and word == "List":
        help = f"write {text} = {'sorted' if name == 'sort' else 'reversed'}({text})"
    elif name in FUNCTIONS:
        help = f"write {name}({text}, ...)" if len(FUNCTIONS[name][0].args) > 1 else f"write {name}({text})"
    else:
        methods = methods_of(type_)
        help = c.suggestion(name, methods) or (f"{with_article(type_)} has {', '.join(methods)}" if methods else "")
        if word == "string":
            help = "join strings with '+', cut them with s[a:b], search them with 'in'; str(...) makes a string"
    c.error("K015", f"{with_article(type_)} has no method {name}", function.name_span, help)


# Functions, ports and records that the program declares


def _function(
    entity: decl.Function | decl.ExternFunction | decl.SpecFunction, node: ast.Call, function: ast.Name, c: Context
) -> ir.Expr:
    name, span = entity.name, node.span
    types = [parameter.type for parameter in entity.parameters]
    usage = f"{name} takes ({', '.join(map(str, types))})"
    nodes = positional_arguments(node, name, (len(types),), usage, c)
    args = _converted_arguments(nodes, types, name, usage, c) if isinstance(nodes, tuple) else (nodes,)
    if c.place == "constant":
        return c.error(
            "K025", f"an initial value cannot call {name}", function.span, "set the variable in init", (), *args
        )
    # Contracts cannot call a spec function either, because robots check contracts.
    if isinstance(entity, decl.SpecFunction) and c.place not in ("property", "guarantee"):
        message = f"{name} is declared by 'spec fun': it can only be used in properties and guarantees"
        help = "a 'fun' or an 'extern fun' can be called everywhere"
        return c.error("K027", message, function.span, help, (), *args)
    if c.function:
        c.calls.setdefault(c.function, set()).add(name)
    if entity.result is POISON or is_poisoned(args):
        return c.poison(span, *args)
    if isinstance(entity, decl.ExternFunction):
        return ir.ExternCall(name, args, entity.result, span)
    return ir.Call(name, args, entity.result, span)


def _port_call(node: ast.Call, module: decl.Module, function: ast.Attribute, c: Context) -> ir.Expr:
    port = declared_port(module, function, c)
    name = f"{module.name}.{function.name}"
    if port is None or port.type is POISON:
        return c.poison(node.span, *checked_arguments(node, c))
    if port.type is not PLANNER:
        skipped = checked_arguments(node, c)
        return c.error(
            "K017", f"{name} is {with_article(port.type)} and is not called", function.span, "", (), *skipped
        )
    usage = f"{name}(goal) and {name}(goal, obstacles) plan a path: obstacles is a List<Grid> or List<Point>"
    nodes = positional_arguments(node, name, (1, 2), usage, c)
    if not isinstance(nodes, tuple):
        return nodes
    goal = converted(check_expr(nodes[0], c), POINT, "the goal", c)
    args = [goal]
    if len(nodes) == 2:
        obstacles = check_expr(nodes[1], c, _OBSTACLES[0])
        if not any(same_type(obstacles.type, type_) for type_ in _OBSTACLES):
            obstacles = converted_argument(obstacles, _OBSTACLES[1], "the second argument", c)
        args.append(obstacles)
    if c.place == "assume" and module.name != c.module:
        message = f"an assumption can only use its module's ports, params and pid, not {name}"
        return c.error("K054", message, node.span, "", (), *args)
    if c.place not in ("init", "effect", "assume"):
        where = {"guard": "a guard", "function": "a function", "constant": "an initial value"}
        what = where.get(c.place, "a property")
        help = "call the port in 'eff:' and keep its answer in a variable"
        message = f"{what} cannot call {name}: the answer of a port is an input of the event"
        return c.error("K027", message, node.span, help, (), *args)
    if c.entry is not None:
        return report_port_call(name, node, c)
    if is_poisoned(args):
        return c.poison(node.span, *args)
    return ir.PortCall(module.name, port.name, tuple(args), _PATH, node.span)


def _record(record: decl.Record, node: ast.Call, c: Context) -> ir.Expr:
    """Check a call that makes a record, such as `Task(target=p)`: values by position, then by name.

    Fields that the call does not mention get the initial values that the record declares.
    """
    type_ = record.type
    names = [name for name, _ in type_.fields]
    given: dict[str, ir.Expr] = {}
    usage = f"{type_.name} has the fields {', '.join(names)}"
    before_names = len([arg for arg in node.args if not isinstance(arg, ast.Keyword)])
    if before_names > len(names):
        args = checked_arguments(node, c)
        message = f"{type_.name} has {len(names)} fields, not {before_names}"
        return c.error("K014", message, node.span, usage, (), *args)
    poisoned, named = False, False
    for position, arg in enumerate(node.args):
        if isinstance(arg, ast.Keyword):
            name, value, span, named = arg.name, arg.value, arg.span, True
        elif named:
            c.error("K014", "a positional value follows a named value", arg.span, usage)
            poisoned = True
            continue
        else:
            name, value, span = names[position], arg, arg.span
        poisoned = not _field(type_.name, type_, name, value, span, given, usage, c) or poisoned
    if poisoned:
        return c.poison(node.span, *given.values())
    missing = [name for name in names if name not in given]
    if missing and not record.defaults:  # the call is in a record's field, checked before the fields of `record`
        message = f"{type_.name} lacks {', '.join(missing)}: within a field's initial value, all fields must be given"
        help = f"give a value for each field of {type_.name}"
        return c.error("K014", message, node.span, help, (), *given.values())
    first = dict(zip(names, record.defaults, strict=False))
    return ir.Make(tuple([given[name] if name in given else first[name] for name in names]), type_, node.span)


def _field(
    record: str, type_: RecordType, name: str, value: ast.Expr, span: Span, given: dict[str, ir.Expr], usage: str,
    c: Context,
) -> bool:  # fmt: skip
    """Check the value of a record's field in a call, add the value to `given`, and return whether it is right."""
    field = field_of(type_, name)
    if field is None:
        check_expr(value, c)
        c.error(
            "K015", f"{record} has no field {name}", span, c.suggestion(name, [n for n, _ in type_.fields]) or usage
        )
        return False
    checked = converted(check_expr(value, c, field), field, f"{record}.{name}", c)
    if name in given:
        c.error("K014", f"{record}.{name} is given twice", span)
        return False
    given[name] = checked
    return checked.type is not POISON


# Match the parameters of a signature, which may have type variables, with the types of arguments.

Bound = dict[str, Type]  # name of a type variable -> type bound to it
_VARIABLES = {variable.name for variable in VARIABLES}
_SHOWN = {"T": "T", "V": "V", "K": "K", "N": "int or float", "O": "int, float or string"}


def match_argument(pattern: Type, value: ir.Expr, bound: Bound) -> ir.Expr | None:
    """Match an argument with the pattern of its parameter: a type that may contain type variables.

    Returns the argument, converted to a float if the pattern is float, or None if the argument does not match. Adds to
    `bound` the types to which the match binds type variables.
    """
    type_ = value.type
    if type_ is pattern:
        return value
    if type_ is INT:
        wanted = bound.get(pattern.name) if isinstance(pattern, Scalar) and pattern.name in _VARIABLES else pattern
        if wanted is FLOAT:
            return ir.Widen(value, FLOAT, value.span)
    if type_ is FLOAT and pattern is N and bound.get("N") is INT:
        bound["N"] = FLOAT
        return value
    return value if _agree(pattern, type_, bound) else None


def _agree(pattern: Type, type_: Type, bound: Bound) -> bool:
    match pattern:
        case Scalar(name) if name in _VARIABLES:
            if name in bound:
                return same_type(bound[name], type_)
            if not _admits(pattern, type_):
                return False
            bound[name] = type_
            return True
        case Sequence(word, element):
            if isinstance(type_, PerRobot):
                return word == "List" and _agree(element, type_.element, bound)
            return isinstance(type_, Sequence) and type_.name == word and _agree(element, type_.element, bound)
        case MapOf(key, value):
            return isinstance(type_, MapOf) and _agree(key, type_.key, bound) and _agree(value, type_.value, bound)
        case _:
            return same_type(pattern, type_)


def _admits(variable: Scalar, type_: Type) -> bool:
    if isinstance(type_, PerRobot):
        return False
    if variable is N:
        return type_ is INT or type_ is FLOAT
    if variable is ORDERED:
        return type_ is INT or type_ is FLOAT or type_ == STRING
    return variable is not K or is_key(type_)


def substituted(pattern: Type, bound: Bound) -> Type | None:
    """Return the pattern with its type variables replaced by types; None if a variable is not bound yet."""
    match pattern:
        case Scalar(name):
            return bound.get(name) if name in _VARIABLES else pattern
        case Sequence(word, element):
            part = substituted(element, bound)
            return None if part is None else pattern if part is element else Sequence(word, part, SHARED_ELEMENTS)
        case MapOf(key, value):
            parts = substituted(key, bound), substituted(value, bound)
            return None if parts[0] is None or parts[1] is None else MapOf(parts[0], parts[1], SHARED_ELEMENTS)
        case TupleOf(items):
            found = [substituted(item, bound) for item in items]
            return None if None in found else TupleOf(tuple([f for f in found if f is not None]))
        case _:
            return pattern


def shown(signature: Signature, skip: int = 0) -> str:
    """Return the parameters of a builtin as text: "(Point, Point)".

    The first `skip` parameters are left out: 1 for a method, whose object comes first.
    """
    return f"({', '.join(_shown(arg) for arg in signature.args[skip:])})"


def _shown(pattern: Type) -> str:
    if isinstance(pattern, Scalar):
        return _SHOWN.get(pattern.name, pattern.name)
    return str(pattern)
