"""A whole IR program -> the text of its `program.py`: the finished strings its template needs, and what it imports."""

from __future__ import annotations

import re
from hashlib import blake2s
from typing import Any

from koordgen import __version__
from koordgen.emit import expr, stmt
from koordgen.emit.names import Names
from koordgen.emit.render import render
from koordgen.ir import decl as ir
from koordgen.ir.stmt import Block
from koordgen.ir.types import Scalar

# Raised when the meaning of a datagram changes; equals that of koordgen/runtime/wire.py (a test compares them).
WIRE_FORMAT = 1

_RUNTIME = ("Cell", "Effects", "Event", "Frame", "Port", "Program", "Slots", "Stopped", "Variable")
_VALUES = ("Point", "Pose", "distance")
_MATH = ("sqrt",)
_MARK = "  # {}:"


def program_text(program: ir.Program) -> str:
    """The generated module, which compiles; anything else is a mistake of this compiler (SyntaxError)."""
    names = Names(program)
    values = _values(program, names)
    body = render("program_state.py", **values) + render("program.py", **values)
    text = _head(program, body) + body
    text = text.replace("LINES: dict[int, int] = {}", f"LINES: dict[int, int] = {_lines(text, program.path)}", 1)
    compile(text, "program.py", "exec")
    return text


def program_hash(program: ir.Program) -> str:
    """16 hexadecimal digits over all that the program means; where it stands in the source takes no part."""
    return _digest(repr(program))


def interface_hash(program: ir.Program) -> str:
    """16 hexadecimal digits over what peers must agree on to read one another's datagrams."""
    return _digest(repr((WIRE_FORMAT, [(v.name, v.kind, v.type) for v in program.shared])))


def _digest(text: str) -> str:
    return blake2s(text.encode(), digest_size=8).hexdigest()


def _values(program: ir.Program, names: Names) -> dict[str, Any]:
    def variables(declared: tuple[ir.Local | ir.Shared, ...], attributes: dict[str, str]) -> list[dict[str, Any]]:
        return [
            {
                "name": v.name,
                "attribute": attributes[v.name],
                "type": python_type(v.type),
                "kind": v.kind if isinstance(v, ir.Shared) else "local",
                "initial": expr.text(v.initial, names),
                "mark": f"{program.path}:{v.span.line}",
            }
            for v in declared
        ]

    def block(statements: Block) -> str:
        return "\n".join(stmt.lines(statements, names, program.path, "    "))

    return {
        "name": program.name,
        "path": program.path,
        "program_hash": program_hash(program),
        "interface_hash": interface_hash(program),
        "params": [
            (names.params[p.name], python_type(p.type), expr.text(p.default, names), f"{program.path}:{p.span.line}")
            for p in program.params
        ],
        "locals": variables(program.locals, names.locals),
        "shared": variables(program.shared, names.shared),
        "ports": [
            (f"{m.name}.{p.name}", names.ports[m.name, p.name], python_type(p.type), p.direction)
            for m in program.modules
            for p in m.ports
        ],
        "init": block(program.init) if program.init else "",
        "events": [
            {
                "name": e.name,
                "line": e.span.line,
                "guard": names.guards[e.name],
                "condition": expr.text(e.guard, names) + _MARK.format(program.path) + str(e.guard.span.line),
                "effect": names.effects[e.name],
                "body": block(e.effect),
            }
            for e in program.events
        ],
    }


def python_type(koord: Scalar) -> str:
    """The Python annotation of a Koord type."""
    return stmt.PYTHON_TYPE[koord.name]


def _head(program: ir.Program, body: str) -> str:
    def used(names: tuple[str, ...]) -> str:
        return ", ".join(n for n in names if re.search(rf"\b{n}\b", body))

    imports = [
        f"from {module} import {found}"
        for module, found in (
            ("math", used(_MATH)),
            ("typing", "Any"),
            ("koordgen.runtime.program", used(_RUNTIME)),
            ("koordgen.runtime.values", used(_VALUES)),
        )
        if found
    ]
    stdlib = [line for line in imports if "koordgen" not in line]
    runtime = [line for line in imports if "koordgen" in line]
    return (
        f'"""{program.name}: the Koord program {program.path}, compiled by koordgen {__version__}.\n\n'
        f"Every statement names its line in {program.path}, which stands beside this file. The next build writes this\n"
        'file anew: change the Koord program, not this.\n"""\n\n'
        "from __future__ import annotations\n\n" + "\n".join(stdlib) + "\n\n" + "\n".join(runtime) + "\n\n"
    )


def _lines(text: str, path: str) -> str:
    """Python line -> Koord line, for every line that ends in a mark; errors on the robot are told by it."""
    mark = re.compile(re.escape(_MARK.format(path)) + r"(\d+)$")
    pairs = ((number, mark.search(line)) for number, line in enumerate(text.split("\n"), 1))
    return "{" + ", ".join(f"{number}: {found[1]}" for number, found in pairs if found) + "}"
