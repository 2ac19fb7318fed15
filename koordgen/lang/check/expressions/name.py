"""Resolution of names, ports and fields, and checks that the current section may read them."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator

from koordgen.lang.check.base import check_expr, with_article
from koordgen.lang.check.context import PREDEFINED, Context
from koordgen.lang.check.expressions.dialect import VALUES, old_name
from koordgen.lang.diagnostics import Label
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.builtins import CONSTANTS, FUNCTIONS, METHODS, UPDATES
from koordgen.lang.ir.decl import (
    ExternFunction,
    ExternTypeDef,
    Function,
    Import,
    Local,
    Module,
    Param,
    Port,
    Record,
    Shared,
    SpecFunction,
)
from koordgen.lang.ir.types import (
    FLOAT,
    GENERIC,
    GRID,
    INT,
    NAMED,
    POINT,
    POISON,
    POSE,
    SCAN,
    MapOf,
    PerRobot,
    RecordType,
    Sequence,
    Type,
    list_of,
)
from koordgen.lang.node import Node, replace
from koordgen.lang.source import Span
from koordgen.lang.syntax import expr as ast
from koordgen.lang.syntax import stmt as tree
from koordgen.lang.syntax.decl import Effect, Event, Init, Priority, Section
from koordgen.lang.syntax.decl import Function as Fun

_MEANT = {"me": "pid"}
_NOTHING = "Koord has no empty value: use a bool, or a special value such as -1"
FOREIGN = {
    "None": _NOTHING,
    "null": _NOTHING,
    "nil": _NOTHING,
    "self": "write a variable by its name alone; this robot's index is pid",
    "this": "write a variable by its name alone; this robot's index is pid",
    **dict.fromkeys(("math", "np", "numpy"), "write functions and constants by their names alone: sqrt(x), sin(x), pi"),
}
# Name of a constant in Python's module `math` -> how to write it in Koord.
_MATHS = {"pi": "pi", "tau": "2 * pi", "e": "exp(1.0)"}
# Name of a function of another language -> help that says what to write in Koord.
NO_FUNCTIONS = {
    "int": "a float is never converted to an int automatically: use floor, ceil or round",
    "float": "an int is converted to a float automatically",
    "bool": "compare the number with 0: 'n != 0'",
    "print": "write to a stream: 'Log.stdout << a << b' with 'stream stdout' under 'using Log:'",
    "pow": "write a ** b",
    "enumerate": "write 'for i in range(len(xs)):'",
    "zip": "write 'for i in range(len(xs)):'",
    "list": "write [a, b]",
    "set": "write {a, b}",
    "dict": "write {k: v}",
    "any": "use a loop: for x in xs: if x: found = True",
    "all": "use a loop: for x in xs: if not x: good = False",
    "map": "fill a list in a loop: for x in xs: ys.append(...)",
    "filter": "fill a list in a loop: for x in xs: ys.append(...)",
    "isinstance": "a variable always has its declared type",
    "type": "a variable always has its declared type",
    "input": "a robot's inputs come from ports: 'using Module:' with 'sensors:'",
}
# Type -> name of a method in another language -> name of the type's method in Koord.
HABITS: dict[str, dict[str, str]] = {
    "List": {"push": "append", "add": "append", "push_back": "append", "put": "append", "delete": "remove"},
    "Queue": {"append": "push", "add": "push", "put": "push", "enqueue": "push", "popleft": "pop", "dequeue": "pop",
              "get": "pop"},
    "Set": {"append": "add", "push": "add", "insert": "add", "discard": "remove", "delete": "remove"},
    "Map": {"pop": "remove", "delete": "remove"},
}  # fmt: skip
_IDS, _FLOATS = list_of(INT), list_of(FLOAT)
FIELDS: dict[str, dict[str, Type]] = {
    POINT.name: {"x": FLOAT, "y": FLOAT, "z": FLOAT},
    POSE.name: {"position": POINT, "yaw": FLOAT},
    GRID.name: {"x": INT, "y": INT, "size": FLOAT},
    SCAN.name: {"angles": _FLOATS, "ranges": _FLOATS, "max_range": FLOAT},
}
_LOOP = "keep the value in a variable that is declared before the loop"
_LENGTHS = ("length", "size", "len", "count", "Length", "Count")
_INSTEAD_OF_A_ROBOT = {"pid": "name the robots: 'forall i in ID:'"}


def check_name(node: ast.Name, c: Context, wanted: Type | None = None) -> ir.Expr:
    name, span = node.name, node.span
    temp = c.temp(name)
    if temp is not None:
        return ir.TempRead(temp.unique, temp.type, span)
    if c.place == "assume":
        found = _port_of(c.entities.get(c.module), name)
        if found is not None:
            return _read_port(c.module, found, span, c)
    if name not in c.entities:
        return _predefined(node, c)
    entity = c.entities[name]
    match entity:
        case Local(type=type_):
            return reject_robot_state("the variable ", name, span, c) or ir.LocalRead(name, type_, span)
        case None:
            return c.poison(span)
        case Param(type=type_):
            return ir.ParamRead(name, type_, span)
        case Shared():
            return _shared(name, entity, span, c)
        case Module():
            return c.error("K017", f"{name} is a module, not a value", span, f"name a port of the module: {name}.port")
        case Import():
            return c.error("K017", f"{name} is an import, not a value", span, f"write {_MEMBERS.format(name)}")
        case Record():
            return c.error("K017", f"{name} is a record, not a value", span, f"{name}(...) makes one")
        case ExternTypeDef():
            return c.error("K017", f"{name} is a type, not a value", span)
        case Function() | ExternFunction() | SpecFunction():
            return c.error("K017", f"{name} is a function and must be called", span, f"write {name}(...)")


def _shared(name: str, entity: Shared, span: Span, c: Context) -> ir.Expr:
    if c.place not in ("property", "provided"):
        wrong = reject_robot_state("the variable ", name, span, c)
        if wrong is not None:
            return wrong
    if c.place == "init":
        return report_shared_in_init(name, span, c)
    if entity.kind == "allread":
        return ir.SlotsRead(name, PerRobot(entity.type), span)
    return ir.SharedRead(name, entity.type, span)


def report_shared_in_init(name: str, span: Span, c: Context) -> ir.Expr:
    help = "other robots may not have run init yet: use a local variable, or read the shared variable in an event"
    return c.error("K023", f"init cannot read {name}: it is shared", span, help)


def reject_robot_state(what: str, name: str, span: Span, c: Context) -> ir.Expr | None:
    """Report an error if the current section cannot read a robot's state; return None if it can.

    `what` begins the message and names the kind of the state that is read, such as "the port ".
    """
    match c.place:
        case "init" | "guard" | "effect":
            return None
        case "constant":
            return c.error("K025", f"an initial value cannot depend on {what}{name}", span, "set the variable in init")
        case "function" | "contract":
            message = f"a function can only read its parameters and params: {what}{name} is neither"
            return c.error("K027", message, span, "pass the value to the function as an argument")
        case "property":
            help = _INSTEAD_OF_A_ROBOT.get(name, f"write {name}[i], with 'forall i in ID:' before it")
            return c.error("K054", f"a property must name the robot whose {name} it reads", span, help)
        case "guarantee":
            both = f"{c.guaranteed} and {c.guaranteed}'"
            message = f"a guarantee can only use {both}, params, and ID and N_SYS, not {what}{name}"
            return c.error("K054", message, span, "an invariant may relate several variables")
        case "provided":
            message = f"a provided port can only use shared variables, params, and ID and N_SYS, not {what}{name}"
            return c.error("K054", message, span, "any robot of the fleet must be able to compute the value")
        case _:
            message = f"an assumption can only use its module's ports, params and pid, not {what}{name}"
            return c.error("K054", message, span)


def _predefined(node: ast.Name, c: Context) -> ir.Expr:
    name, span = node.name, node.span
    if name == "pid":
        return (reject_robot_state("", name, span, c) if c.place != "assume" else None) or ir.Pid(INT, span)
    if name == "N_SYS" or name == "ID":
        wrong = (
            reject_robot_state("", name, span, c)
            if c.place not in ("property", "assume", "guarantee", "provided")
            else None
        )
        return wrong or (ir.NSys(INT, span) if name == "N_SYS" else ir.Ids(_IDS, span))
    if name in CONSTANTS:
        return ir.Const(CONSTANTS[name], FLOAT, span)
    if name in FUNCTIONS:
        return c.error("K017", f"{name} is a function and must be called", span, f"write {name}(...)")
    if name in NAMED or name in GENERIC:
        return c.error("K017", f"{name} is a type, not a value", span)
    if name == "range":
        return c.error("K017", "range is not a value", span, "use range in a loop: 'for i in range(n):'")
    if name in VALUES:
        return check_expr(old_name(node, c), c)
    return report_undefined(name, span, c)


def report_undefined(name: str, span: Span, c: Context) -> ir.Expr:
    """Report an undefined name, unless text that could not be parsed may define it."""
    if name in c.broken or name in c.owners:
        return c.poison(span)
    if c.place == "assume":
        from koordgen.lang.check.property import bind_goal

        temp = bind_goal(name, span, c)
        if temp is not None:
            return ir.TempRead(temp.unique, temp.type, span)
    if c.place == "property":
        from koordgen.lang.check.property import bind_any_value

        temp = bind_any_value(name, span, c)
        if temp is not None:
            return ir.TempRead(temp.unique, temp.type, span)
    if is_event(name, c):
        help = "a robot chooses its events by their guards; use a variable to record that an event has run"
        return c.error("K017", f"{name} is an event, not a value", span, help)
    if report_ended(name, span, c):
        return c.poison(span)
    if name in ("raise", "throw"):
        from koordgen.lang.syntax.habits import FOREIGN as WORDS

        return c.error("K010", f"Koord has no '{name}'", span, WORDS[name])
    help = FOREIGN.get(name) or c.suggestion(name, c.visible_names(), _MEANT)
    if not help and c.place == "property":
        help = f"if {name} is a robot, bind the name: 'forall {name} in ID:'"
    return c.error("K010", f"{name} is not defined", span, help)


def report_not_called(name: str, span: Span, c: Context) -> None:
    """Report a call of a value that is no function. If its name hides a builtin function, the message says so."""
    owner = c.temp(name) or c.entities.get(name)
    if name not in FUNCTIONS or owner is None:
        c.error("K017", f"{name} is not a function", span)
        return
    labels = (Label(owner.span, f"this name hides the builtin function {name}"),)
    message = f"{name} is not a function here: a variable has the same name"
    c.error("K017", message, span, "give the variable another name", labels)


def is_event(name: str, c: Context) -> bool:
    return f"event {name}" in c.owners


def report_ended(name: str, span: Span, c: Context) -> bool:
    """Report a use of a variable after the block or loop that declares it.

    Returns False if the name does not belong to a variable whose block has ended.
    """
    if name not in c.minted or c.program is None:
        return False
    here = span.line, span.column
    sections = c.program.sections
    section = sections[bisect_left(sections, here, key=_start) - 1]
    for statement in _backwards(section, here):
        match statement:
            case tree.Declare(type_, declared, place) if declared == name:
                help = f"declare {name} before the block: '{c.text(type_.span)} {name}'"
            case tree.For(names=names) if name in [part.name for part in names]:
                place, help = statement.span, _LOOP
            case tree.CountedFor(ast.Name(counter)) if counter == name:
                place, help = statement.span, _LOOP
            case _:
                continue
        labels = (Label(place, "declared here, in a block that has ended"),)
        c.error("K010", f"{name} is not defined here: its block has ended", span, help, labels)
        return True
    return False


def _start(node: Section | tree.Stmt) -> tuple[int, int]:
    return node.span.line, node.span.column


def _inner(node: Section | tree.Stmt) -> tuple[tree.Block, ...]:
    """Return the blocks that a section or a statement directly contains."""
    match node:
        case Event(clauses=clauses):
            return tuple([clause.block for clause in clauses if isinstance(clause, Effect)])
        case Priority(events):
            return tuple([block for event in events for block in _inner(event)])
        case tree.If(branches, orelse):
            return (*(branch.block for branch in branches), orelse)
        case Init(block) | Fun(block=block) | tree.Atomic(block):
            return (block,)
        case tree.For(block=block) | tree.CountedFor(block=block) | tree.While(block=block):
            return (block,)
        case _:
            return ()


def _backwards(node: Section | tree.Stmt, here: tuple[int, int]) -> Iterator[tree.Stmt]:
    """Yield the statements in a node that begin before a position, from the last to the first."""
    for block in reversed(_inner(node)):
        for place in range(bisect_left(block, here, key=_start) - 1, -1, -1):
            yield from _backwards(block[place], here)
            yield block[place]


_MEMBERS = "{0}.N_SYS, {0}.ID or {0}.pid"


def import_named(node: ast.Expr, c: Context) -> Import | None:
    """Return the import whose name an expression consists of, or None."""
    if type(node) is not ast.Name or c.temp(node.name) is not None:
        return None
    entity = c.entities.get(node.name)
    return entity if type(entity) is Import else None


def _member(imported: Import, node: ast.Attribute, c: Context) -> ir.Expr:
    """Check `Name.N_SYS` and `Name.pid`, which describe the robots that run an imported application."""
    name, span, text = node.name, node.span, f"{imported.name}.{node.name}"
    if name == "pid":
        return reject_robot_state("", text, span, c) or ir.LocalRead(imported.pid, INT, span)
    if name in ("N_SYS", "ID") and c.place in ("assume", "guarantee"):
        return reject_robot_state("", text, span, c) or c.poison(span)
    if name == "N_SYS":
        return ir.ParamRead(imported.size, INT, span)
    if name == "ID":
        help = f"use it in a loop or a quantifier: 'forall i in {text}:'"
        return c.error("K017", f"{text} is not a value", span, help)
    help = f"write {name}" if name in imported.variables else f"write {_MEMBERS.format(imported.name)}"
    return c.error("K060", f"the import {imported.name} has no part {name}", node.name_span, help)


def check_attribute(node: ast.Attribute, c: Context, wanted: Type | None = None) -> ir.Expr:
    imported = import_named(node.value, c)
    if imported is not None:
        return _member(imported, node, c)
    module = module_named(node.value, c)
    if module is not None:
        port = declared_port(module, node, c)
        return c.poison(node.span) if port is None else _read_port(module.name, port, node.span, c)
    if type(node.value) is ast.Name and is_unknown(node.value.name, c) and node.name.lower() in _MATHS:
        name = node.value.name  # for example math.pi
        return c.error("K010", f"{name} is not defined", node.value.span, f"write {_MATHS[node.name.lower()]}")
    operand = check_expr(node.value, c)
    if operand.type is POISON:
        return c.poison(node.span, operand)
    field = field_of(operand.type, node.name)
    if field is None:
        return report_no_field(operand, node, c)
    return ir.Field(operand, node.name, field, node.span)


def module_named(node: ast.Expr, c: Context) -> Module | None:
    """Return the module whose name an expression consists of, or None."""
    if type(node) is not ast.Name:
        return None
    entity = c.entities.get(node.name)
    return entity if type(entity) is Module and c.temp(node.name) is None else None


def _port_of(module: Node | None, name: str) -> Port | None:
    for port in module.ports if isinstance(module, Module) else ():
        if port.name == name:
            return port
    return None


def assumed_port(name: str, c: Context) -> Module | None:
    """Return the module whose assumption is being checked, if the module has a port called `name`; else None."""
    module = c.entities.get(c.module)
    return module if isinstance(module, Module) and _port_of(module, name) is not None else None


def declared_port(module: Module, node: ast.Attribute, c: Context) -> Port | None:
    """Return the port `module.name`. If the program does not declare it, report this and return None."""
    port = _port_of(module, node.name)
    if port is None and node.name not in c.broken:
        help = c.suggestion(node.name, [p.name for p in module.ports]) or f"declare it under 'using {module.name}:'"
        c.error("K018", f"the port {module.name}.{node.name} is not declared", node.name_span, help)
    return port


def _read_port(module: str, port: Port, span: Span, c: Context) -> ir.Expr:
    name = f"{module}.{port.name}"
    if port.direction == "callable":
        return c.error("K017", f"{name} is a callable port and cannot be read", span, f"write {name}(goal)")
    if port.direction == "stream":
        return c.error("K056", f"{name} is a stream and cannot be read", span, f"write {name} << ...")
    if c.place == "assume" and module == c.module:
        return ir.PortRead(module, port.name, False, port.type, span)
    return reject_robot_state("the port ", name, span, c) or ir.PortRead(module, port.name, False, port.type, span)


def check_primed(node: ast.Primed, c: Context, wanted: Type | None = None) -> ir.Expr:
    if c.place == "guarantee":
        return _after_write(node, c)
    if c.place != "assume":
        help = "a prime means the port's value during the next delta: 'assume position' in Rect(position, target)'"
        return c.error("K054", "a prime can only be used under 'assume'", node.span, help)
    value = check_expr(node.value, c)
    if isinstance(value, ir.PortRead) and not value.primed:
        return replace(value, primed=True, span=node.span)
    return value if value.type is POISON else c.error("K054", "a prime must follow the name of a port", node.span)


def _after_write(node: ast.Primed, c: Context) -> ir.Expr:
    """Check a prime in a guarantee: the value of the exported variable after a write."""
    name = c.guaranteed
    temp = c.temp(f"{name}'")
    if isinstance(node.value, ast.Name) and node.value.name == name and temp is not None:
        return ir.TempRead(temp.unique, temp.type, node.span)
    help = f"{name}' is the value of {name} after a write"
    return c.error("K054", f"in this guarantee a prime must follow the name {name}", node.span, help)


def fields_of(type_: Type) -> dict[str, Type]:
    return dict(type_.fields) if isinstance(type_, RecordType) else FIELDS.get(str(type_), {})


def field_of(type_: Type, name: str) -> Type | None:
    if type_ is POINT:
        return FLOAT if name in ("x", "y", "z") else None
    return fields_of(type_).get(name)


def type_word(type_: Type) -> str:
    """Return the name under which a type stands in the tables of methods."""
    return type_.name if isinstance(type_, Sequence) else "Map" if isinstance(type_, MapOf) else str(type_)


def methods_of(type_: Type) -> list[str]:
    word = type_word(type_)
    return [name for of, name in (*METHODS, *UPDATES, ("List", "pop"), ("Queue", "pop")) if of == word]


def report_no_field(operand: ir.Expr, node: ast.Attribute, c: Context) -> ir.Expr:
    """Report a read of a field that a value does not have, and suggest what to write."""
    type_, name, text = operand.type, node.name, c.text(node.value.span)
    fields = fields_of(type_)
    if name in _LENGTHS and (isinstance(type_, (Sequence, MapOf, PerRobot)) or str(type_) == "string"):
        help = f"write len({text})"
    elif name in methods_of(type_):
        help = f"{name} is a method: write {text}.{name}(...)"
    elif isinstance(type_, PerRobot):
        help = f"{text}[i] is the value of robot i"
    elif isinstance(type_, MapOf):
        help = f"the value of a key is {text}[key]"
    else:
        help = c.suggestion(name, fields) or (f"{with_article(type_)} has {_listed(fields)}" if fields else "")
    return c.error("K015", f"{with_article(type_)} has no field {name}", node.name_span, help, (), operand)


def _listed(fields: dict[str, Type]) -> str:
    *others, last = (f".{name}" for name in fields)
    return f"{', '.join(others)} and {last}" if others else last


def is_unknown(name: str, c: Context) -> bool:
    """Return whether a name is undefined and does not occur in text that could not be parsed."""
    return c.temp(name) is None and not names_a_value(name, c) and name not in c.broken and name not in c.owners


def names_a_value(name: str, c: Context) -> bool:
    """Return whether a name denotes a temp, a declaration, or a predefined name other than a builtin function."""
    return c.temp(name) is not None or name in c.entities or (name in PREDEFINED and name not in FUNCTIONS)
