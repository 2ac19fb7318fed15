"""A whole IR program -> the text of its `program.py`: the finished strings its template needs, and what it imports."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from hashlib import blake2s
from typing import Any

from koordgen import __version__
from koordgen.build.emit import expr, floats, library, stmt
from koordgen.build.emit.names import Names
from koordgen.build.emit.render import render
from koordgen.build.emit.types import annotation, bound, default, display
from koordgen.lang.ir import decl as ir
from koordgen.lang.ir.encoding import encode
from koordgen.lang.ir.ports import clears, held
from koordgen.lang.ir.stmt import Block
from koordgen.lang.ir.types import MapOf, RecordType, TupleOf, Type
from koordgen.lang.ir.types import Sequence as SequenceOf

# Raised when the meaning of a datagram changes; equals that of koordgen/runtime/net/wire.py (a test compares them).
WIRE_FORMAT = 4

_MARK = "  # {}:"
_LINES = "\nLINES: dict[int, int] = {"


def program_text(program: ir.Program, functions: bytes = b"") -> str:
    """The generated module, which compiles; anything else is a mistake of this compiler (SyntaxError). `functions` is
    the user's Python file, if there is one."""
    values = {**_values(program, Names(program)), "program_hash": program_hash(program, functions)}
    body = render("program_state.py", **values).strip("\n") + "\n" + render("program.py", **values)
    text = _head(program, body) + ("\n\n" if body.startswith("class ") else "\n") + body
    text = text.replace(_LINES, _LINES + _lines(text, program.path), 1)  # a literal has no raw end of line
    compile(text, "program.py", "exec")
    return text


def program_hash(program: ir.Program, functions: bytes = b"") -> str:
    """16 hexadecimal digits over the canonical encoding of the program (ir/encoding.py) and the bytes of its functions
    file. Robots with different hashes refuse one another."""
    return _digest(encode("program", program, blake2s(functions).hexdigest()))


def interface_hash(program: ir.Program) -> str:
    """16 hexadecimal digits over what peers must agree on to read one another's datagrams."""
    shared = tuple([(v.name, v.kind, v.type) for v in program.shared])
    return _digest(encode("interface", WIRE_FORMAT, shared))


def functions_module(program: ir.Program) -> str:
    """The module beside a generated program that holds its extern functions and types; what can be in a file's name and
    not in a module's is an underscore."""
    return re.sub(r"\W", "_", f"{program.name}_functions")


def _digest(data: bytes) -> str:
    return blake2s(data, digest_size=8).hexdigest()


def _values(program: ir.Program, names: Names) -> dict[str, Any]:
    return {
        "name": program.name,
        "path": program.path,
        "name_literal": expr.literal(program.name),
        "path_literal": expr.literal(program.path),
        "library": expr.literal(functions_module(program)),
        "interface_hash": interface_hash(program),
        "extern_types": [(expr.literal(t.name), names.extern_types[t.name]) for t in program.extern_types],
        "records": [_record(r, program, names) for r in _ordered(program.records)],
        "params": [
            (names.params[p.name], annotation(p.type, names), expr.text(p.default, names), _mark(program, p))
            for p in program.params
        ],
        "externs": [_extern(f, program, names) for f in program.externs],
        "functions": [_function(f, program, names) for f in program.functions],
        "locals": [_variable(v, "local", names.locals, program, names) for v in program.locals],
        "shared": [_variable(v, v.kind, names.shared, program, names) for v in program.shared],
        "ports": [_port(program, m, p, names) for m in program.modules for p in m.ports],
        "init": _block(program.init, program, names) if program.init else "",
        "events": [_event(e, program, names) for e in program.events],
        "locks": display([display([expr.literal(name) for name in group]) for group in program.locks]),
    }


def _mark(program: ir.Program, node: Any) -> str:
    return f"{program.path}:{node.span.line}"


def _block(statements: Block, program: ir.Program, names: Names, parameters: tuple[str, ...] = ()) -> str:
    known = names.within(floats.kinds(statements, parameters))
    return "\n".join(stmt.lines(statements, known, program.path, stmt.STEP))


def _variable(
    v: ir.Local | ir.Shared, kind: str, attributes: dict[str, str], program: ir.Program, names: Names
) -> dict[str, str]:
    return {
        "name": v.name,
        "attribute": attributes[v.name],
        "type": annotation(v.type, names),
        "bound": bound(v.type, names),
        "kind": kind,
        "initial": expr.text(v.initial, names),
        "mark": _mark(program, v),
    }


def _record(record: ir.Record, program: ir.Program, names: Names) -> dict[str, Any]:
    fields = names.fields[record.type.name]
    return {
        "name": names.records[record.type.name],
        "doc": f"def {record.type.name}, {_mark(program, record)}",
        "fields": [
            (fields[field], annotation(type_, names), expr.text(value, names))
            for (field, type_), value in zip(record.type.fields, record.defaults, strict=True)
        ],
    }


def _ordered(records: Iterable[ir.Record]) -> list[ir.Record]:
    """Each after those that it has fields of: their first values are made with it."""
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


def _signature(function: ir.Function | ir.ExternFunction, names: Names) -> dict[str, str]:
    return {
        "parameters": ", ".join([f"{names.temp(p.name)}: {annotation(p.type, names)}" for p in function.parameters]),
        "type": annotation(function.result, names),
    }


def _function(function: ir.Function, program: ir.Program, names: Names) -> dict[str, str]:
    return {
        "name": names.functions[function.name],
        "mark": f"{function.name}, {_mark(program, function)}",
        "body": f"{stmt.STEP}turn(){_MARK.format(program.path)}{function.span.line}\n"
        + _block(function.block, program, names, tuple([p.name for p in function.parameters])),
        **_signature(function, names),
    }


def _extern(function: ir.ExternFunction, program: ir.Program, names: Names) -> dict[str, Any]:
    word = str(function.result)
    article = "an" if word[0] in "aeiouAEIO" else "a"
    return {
        "name": expr.literal(function.name),
        "function": names.externs[function.name],
        "call": names.calls[function.name],
        "args": ", ".join([names.temp(p.name) for p in function.parameters]),
        "bounds": display([bound(p.type, names) for p in function.parameters]),
        "bound": bound(function.result, names),
        "wanted": expr.literal(f"{article} {word}"),
        "mark": f"{function.name}, {_mark(program, function)}",
        "requires": [(expr.text(formula, names), formula.span.line) for formula in function.requires],
        "ensures": [(expr.text(formula, names), formula.span.line) for formula in function.ensures],
        **_signature(function, names),
    }


def _port(program: ir.Program, module: ir.Module, port: ir.Port, names: Names) -> dict[str, str]:
    name, rest = f"{module.name}.{port.name}", ", is_position=True" if port.meaning.is_position else ""
    if port.direction == "actuator":
        rest = f", {bound(port.type, names)}, lambda: {default(port.type, names)}"
        if sensor := held(program).get(name):
            rest += f", held={expr.literal(sensor)}"
        if cleared := clears(program).get(name):
            rest += f", clears=({', '.join(map(expr.literal, cleared))},)"
    return {
        "name": expr.literal(name),
        "attribute": names.ports[module.name, port.name],
        "direction": port.direction,
        "type": annotation(port.type, names),
        "rest": rest,
    }


def _event(event: ir.Event, program: ir.Program, names: Names) -> dict[str, Any]:
    return {
        "name": event.name,
        "line": event.span.line,
        "mark": f"{event.name}, {_mark(program, event)}",
        "guard": names.guards[event.name],
        "condition": expr.text(event.guard, names) + _MARK.format(program.path) + str(event.guard.span.line),
        "effect": names.effects[event.name],
        "body": _block(event.effect, program, names),
        "lock": "" if event.lock is None else f", {event.lock}",
    }


def _head(program: ir.Program, body: str) -> str:
    groups: Sequence[list[str]] = [group for group in library.imports(body) if group]
    return (
        f'"""{program.name}: the Koord program {program.path}, compiled by koordgen {__version__}.\n\n'
        f"Every statement names its line in {program.path}, which stands beside this file. The next build writes this\n"
        'file anew: change the Koord program, not this.\n"""\n\n'
        "from __future__ import annotations\n\n" + "\n\n".join("\n".join(group) for group in groups) + "\n"
    )


def _lines(text: str, path: str) -> str:
    """Python line -> Koord line, for every line that ends in a mark; errors on the robot are told by it."""
    mark = re.compile(re.escape(_MARK.format(path)) + r"(\d+)$")
    pairs = ((number, mark.search(line)) for number, line in enumerate(text.split("\n"), 1))
    return ", ".join(f"{number}: {found[1]}" for number, found in pairs if found)
