"""Generator of `program.py` from the IR. Records imports and the line map while it writes the text."""

from __future__ import annotations

import re
from collections.abc import Iterable
from hashlib import blake2s

from koordgen import __version__
from koordgen.build.emit import expr, floats, library, stmt
from koordgen.build.emit.layout import STEP, Page, brackets, display, joined, line_map, text
from koordgen.build.emit.names import Names
from koordgen.build.emit.types import annotation, bound, bound_of_record, default
from koordgen.lang.ir import decl as ir
from koordgen.lang.ir.encoding import encode
from koordgen.lang.ir.ports import clears, held
from koordgen.lang.ir.stmt import Block
from koordgen.lang.ir.types import MapOf, RecordType, TupleOf, Type
from koordgen.lang.ir.types import Sequence as SequenceOf
from koordgen.lang.source import Span

# To be increased when the meaning of a datagram changes; equal to that of koordgen/runtime/net/wire.py (tested).
WIRE_FORMAT = 4


_NOTES = "# Python and Koord compute the same values. Operators and functions that need an explanation:"


def program_text(program: ir.Program, functions: bytes = b"") -> str:
    """Return the text of the generated module.

    `functions`: content of the functions file; empty if the program has none. The text is compiled once as a check: a
    SyntaxError is a bug of this compiler.
    """
    names = Names(program)
    body = Page()
    _add_types(body, program, names)
    _add_state(body, program, names)
    _add_functions(body, program, names)
    _add_events(body, program, names)
    _add_provided(body, program, names)
    body.gap()
    tables = _tables(program, names, program_hash(program, functions))
    head = _head(program, names)
    found = text(head, body, line_map(head, body, program.path), tables)
    compile(found, "program.py", "exec")
    return found


def program_hash(program: ir.Program, functions: bytes = b"") -> str:
    """Return a hash, 16 hexadecimal digits, of the program's canonical encoding (ir/encoding.py) and functions file.

    Robots with different hashes refuse one another.
    """
    return digest(encode("program", program, blake2s(functions).hexdigest()))


def interface_hash(program: ir.Program) -> str:
    """Return a hash, 16 hexadecimal digits, of the wire format and the shared variables.

    Robots with equal hashes can read the datagrams of one another.
    """
    shared = tuple([(v.name, v.kind, v.type) for v in program.shared])
    return digest(encode("interface", WIRE_FORMAT, shared))


def functions_module(program: ir.Program) -> str:
    """Return the name of the module with the extern functions and types.

    Characters that cannot stand in a module's name become underscores.
    """
    return re.sub(r"\W", "_", f"{program.name}_functions")


def digest(data: bytes) -> str:
    """Return the hash of some bytes as 16 hexadecimal digits."""
    return blake2s(data, digest_size=8).hexdigest()


def _place(program: ir.Program, span: Span) -> str:
    return f"{program.path}:{span.line}"


def _head(program: ir.Program, names: Names) -> Page:
    page = Page()
    page.add(f'"""{program.name}: the Koord program {program.path}, compiled by koordgen {__version__}.')
    page.gap(1)
    page.add(f"The comment `# line 12` names a line of {program.path}, in the folder of this file.")
    page.add("`s` is the state that an event reads and writes; `my_x` is a variable `x` declared in the event.")
    page.add("The next build overwrites this file: change the Koord program instead.")
    page.add('"""')
    add_imports(page, library.imports(names.used))
    add_notes(page, names, _NOTES)
    return page


def add_imports(page: Page, groups: Iterable[list[str]]) -> None:
    """Add import lines, after the `__future__` import."""
    for group in (["from __future__ import annotations"], *groups):
        if group:
            page.gap(1)
            page.lines += [(line, 0) for line in group]


def add_notes(page: Page, names: Names, heading: str) -> None:
    """Add the comments that explain calls and operators of a module."""
    found = library.notes(names.used, heading)
    if found:
        page.gap(1)
        page.lines += [(line, 0) for line in found]


def _add_types(page: Page, program: ir.Program, names: Names) -> None:
    """Add extern types, records, params and extern functions."""
    page.gap(1 if program.extern_types else 0)
    for t in program.extern_types:
        opaque = f"{names.use('Annotated')}[{names.use('Opaque')}, {expr.literal(t.name)}]"
        page.add(f"{names.extern_types[t.name]} = {opaque}")
    records = _ordered(program.records)
    for record in records:
        _add_record(page, record, program, names)
    if records:
        page.gap()
        page.add("# Size bounds of records.")
    for record in records:
        bounds = bound_of_record(record.type, names)
        page.add(joined(f"{names.bound(record.type.name, bounds)} = ", bounds))
    page.gap(1 if program.params else 0)
    for p in program.params:
        declared = joined(f"{names.params[p.name]}: ", annotation(p.type, names))
        page.add(joined(declared, " = ", expr.text(p.default, names)), line=p.span.line)
    if program.externs:
        page.gap(1)
        library_ = expr.literal(functions_module(program))
        page.add(f"LIBRARY = {names.use('Library')}({library_})")
        for function in program.externs:
            page.add(_extern(function, names))


def _add_record(page: Page, record: ir.Record, program: ir.Program, names: Names) -> None:
    page.gap()
    settings = "frozen=True, array_like=True, forbid_unknown_fields=True"
    page.add(f"class {names.records[record.type.name]}({names.use('Struct')}, {settings}):")
    page.add(f'"""def {record.type.name}, {_place(program, record.span)}"""', STEP)
    page.gap(1)
    fields = names.fields[record.type.name]
    for (field, type_), value in zip(record.type.fields, record.defaults, strict=True):
        page.add(joined(f"{fields[field]}: ", annotation(type_, names), " = ", expr.text(value, names)), STEP)


def _extern(function: ir.ExternFunction, names: Names) -> str:
    word = str(function.result)
    article = "an" if word[0] in "aeiouAEIO" else "a"
    arguments = [
        "library=LIBRARY",
        f"name={expr.literal(function.name)}",
        joined("parameters=", display([bound(p.type, names) for p in function.parameters])),
        joined("result=", bound(function.result, names)),
        joined("type=", annotation(function.result, names)),
        f"wanted={expr.literal(f'{article} {word}')}",
    ]
    return brackets(f"{names.calls[function.name]} = {names.use('Extern')}(", arguments, ")")


def _add_state(page: Page, program: ir.Program, names: Names) -> None:
    """Add the class State, which an event reads and writes."""
    page.gap()
    page.add(f"class State({names.use('Transaction')}):")
    page.add(f'"""State of one robot during one event of {program.name}, with the writes of the event so far."""', STEP)
    page.gap(1)
    page.add(f"def __init__(self, frame: {names.use('Frame')}) -> None:", STEP)
    inner = STEP * 2
    page.add("super().__init__(frame)", inner)
    ports = [(m, p) for m in program.modules for p in m.ports]
    for m, p in ports:
        type_, name = annotation(p.type, names), expr.literal(f"{m.name}.{p.name}")
        attribute = f"self.{names.ports[m.name, p.name]}: "
        if p.direction == "sensor":
            page.add(joined(attribute, type_, " = ", brackets("frame.sensors[", [name], "]")), inner)
        elif p.direction == "actuator":
            page.add(_attribute(attribute, names.use("Cell"), type_, f"self.actuator({name})"), inner)
    for v in program.shared:
        attribute, name = f"self.{names.shared[v.name]}: ", expr.literal(v.name)
        kind, made = ("Slots", "slots") if v.kind == "allread" else ("Cell", "shared")
        page.add(_attribute(attribute, names.use(kind), annotation(v.type, names), f"self.{made}({name})"), inner)
    for w in program.locals:
        attribute, made = f"self.{names.locals[w.name]}: ", f"self.local({expr.literal(w.name)})"
        page.add(_attribute(attribute, names.use("Cell"), annotation(w.type, names), made), inner)
    for m, p in ports:
        if p.direction == "callable":
            name = expr.literal(f"{m.name}.{p.name}")
            add_callable(page, names.ports[m.name, p.name], annotation(p.type, names), name, "call", names)


def _attribute(name: str, kind: str, type_: str, value: str) -> str:
    return joined(name, brackets(f"{kind}[", [type_], "]"), f" = {value}")


def add_callable(page: Page, method: str, type_: str, port: str, asked: str, names: Names) -> None:
    """Add the method of a callable port. `asked`: name of the base class's method that returns the port's answer."""
    names.use("calls")
    page.gap(1)
    page.add(joined(f"def {method}(self, *args: {names.use('Any')}) -> ", type_, ":"), STEP)
    page.add(f'"""A call of {port}{" in the program" if asked == "answer" else ""}."""', STEP * 2)
    page.add(joined("found: ", type_, f" = self.{asked}({port}, args)"), STEP * 2)
    page.add("return found", STEP * 2)


def _add_functions(page: Page, program: ir.Program, names: Names) -> None:
    for x in program.externs:
        _add_signature(page, names.externs[x.name], x, names)
        page.add(f'"""extern fun {x.name}, {_place(program, x.span)}"""', STEP)
        call = names.calls[x.name]
        for formula in x.requires:
            page.add(brackets(f"{call}.require(", [expr.text(formula, names), str(formula.span.line)], ")"), STEP)
        args = [names.temp(p.name) for p in x.parameters]
        page.add(joined("my_result: ", annotation(x.result, names), " = ", brackets(f"{call}(", args, ")")), STEP)
        for formula in x.ensures:
            held = [expr.text(formula, names), str(formula.span.line), "my_result"]
            page.add(brackets(f"{call}.ensure(", held, ")"), STEP)
        page.add("return my_result", STEP)
    for f in program.functions:
        _add_signature(page, names.functions[f.name], f, names)
        page.add(f'"""fun {f.name}, {_place(program, f.span)}"""', STEP)
        page.add(f"{names.use('turn')}()", STEP, f.span.line)
        _add_block(page, f.block, names, tuple([p.name for p in f.parameters]))


def _add_signature(page: Page, name: str, function: ir.Function | ir.ExternFunction, names: Names) -> None:
    names.use("calls")
    parameters = [joined(f"{names.temp(p.name)}: ", annotation(p.type, names)) for p in function.parameters]
    page.gap()
    page.add(joined(brackets(f"def {name}(", parameters, ")"), " -> ", annotation(function.result, names), ":"))


def _add_block(page: Page, block: Block, names: Names, parameters: tuple[str, ...] = ()) -> None:
    stmt.add_block(page, block, names.within(floats.kinds(block, parameters)), STEP)


def _add_events(page: Page, program: ir.Program, names: Names) -> None:
    if program.init:
        page.gap()
        page.add("def init(s: State) -> None:")
        _add_block(page, program.init, names)
    for e in program.events:
        page.gap()
        page.add(f"def {names.guards[e.name]}(s: State) -> bool:")
        page.add(f'"""pre of {e.name}, {_place(program, e.span)}"""', STEP)
        page.add(joined("return ", expr.text(e.guard, names)), STEP, e.guard.span.line)
        page.gap()
        page.add(f"def {names.effects[e.name]}(s: State) -> None:")
        page.add(f'"""eff of {e.name}, {_place(program, e.span)}"""', STEP)
        _add_block(page, e.effect, names)


def _add_provided(page: Page, program: ir.Program, names: Names) -> None:
    """Add a function for each sensor that the program provides to the program of another fleet."""
    for module in program.provides:
        for each in module.ports:
            if each.port.direction == "sensor":
                function = names.provided[module.name, each.port.name]
                page.gap()
                page.add(joined(f"def {function}(s: State) -> ", annotation(each.port.type, names), ":"))
                page.add(f'"""provided {module.name}.{each.port.name}, {_place(program, each.port.span)}"""', STEP)
                page.add(joined("return ", expr.text(each.value, names)), STEP, each.value.span.line)


def _tables(program: ir.Program, names: Names, hashed: str) -> Page:
    page = Page()
    page.gap(1)
    page.add(f"PROGRAM = {names.use('Program')}(")
    page.add(f"name={expr.literal(program.name)},", STEP)
    page.add(f"source={expr.literal(program.path)},", STEP)
    page.add(f'program_hash="{hashed}",', STEP)
    page.add(f'interface_hash="{interface_hash(program)}",', STEP)
    add_table(page, "locals", [(_variable(v, "local", names), v.span.line) for v in program.locals])
    add_table(page, "shared", [(_variable(v, v.kind, names), v.span.line) for v in program.shared])
    add_table(page, "ports", [(_port(program, m, p, names), 0) for m in program.modules for p in m.ports])
    page.add(f"init={'init' if program.init else 'None'},", STEP)
    add_table(page, "events", [(_event(e, names), 0) for e in program.events])
    page.add("begin=State,", STEP)
    page.add("file=__file__,", STEP)
    page.add("lines=LINES,", STEP)
    groups = [display([expr.literal(name) for name in group]) for group in program.locks]
    page.add(joined("locks=", display(groups), ","), STEP)
    page.add(f"library={'LIBRARY' if program.externs else 'None'},", STEP)
    page.add(")")
    return page


def add_table(page: Page, name: str, rows: Iterable[tuple[str, int]]) -> None:
    """Add a keyword argument whose value is a tuple.

    `rows`: pairs of an item's text and the item's line in the program; 0 if the item has no line.
    """
    found = list(rows)
    if not found:
        page.add(f"{name}=(),", STEP)
        return
    page.add(f"{name}=(", STEP)
    for row, line in found:
        page.add(joined(row, ","), STEP * 2, line)
    page.add("),", STEP)


def _variable(v: ir.Local | ir.Shared, kind: str, names: Names) -> str:
    arguments = [
        f"name={expr.literal(v.name)}",
        f'kind="{kind}"',
        joined("type=", annotation(v.type, names)),
        joined("bound=", bound(v.type, names)),
        joined("initial=lambda: ", expr.text(v.initial, names)),
    ]
    return brackets(f"{names.use('Variable')}(", arguments, ")")


def _ordered(records: Iterable[ir.Record]) -> list[ir.Record]:
    """Sort records so that each one stands after the records in its own fields: its initial value needs them."""
    by_name = {r.type.name: r for r in records}
    found: dict[str, ir.Record] = {}

    def add(type_: Type) -> None:
        match type_:
            case RecordType(name, fields) if name not in found:
                for _, field in fields:
                    add(field)
                found[name] = by_name[name]
            case TupleOf(items):
                for item in items:
                    add(item)
            case SequenceOf(_, element):
                add(element)
            case MapOf(key, value):
                add(key)
                add(value)
            case _:
                pass

    for record in by_name.values():
        add(record.type)
    return list(found.values())


def _port(program: ir.Program, module: ir.Module, port: ir.Port, names: Names) -> str:
    name = f"{module.name}.{port.name}"
    arguments = [
        f"name={expr.literal(name)}",
        f'direction="{port.direction}"',
        joined("type=", annotation(port.type, names)),
    ]
    if port.direction == "actuator":
        arguments += [
            joined("bound=", bound(port.type, names)),
            joined("unset=lambda: ", default(port.type, names)),
        ]
    if port.meaning.is_position:
        arguments.append("is_position=True")
    if sensor := held(program).get(name):
        arguments.append(f"held={expr.literal(sensor)}")
    if cleared := clears(program).get(name):
        arguments.append(joined("clears=", display([expr.literal(each) for each in cleared])))
    return brackets(f"{names.use('Port')}(", arguments, ")")


def _event(event: ir.Event, names: Names) -> str:
    arguments = [
        f"name={expr.literal(event.name)}",
        f"line={event.span.line}",
        f"guard={names.guards[event.name]}",
        f"effect={names.effects[event.name]}",
    ]
    lock = [] if event.lock is None else [f"lock={event.lock}"]
    return brackets(f"{names.use('Event')}(", arguments + lock, ")")
