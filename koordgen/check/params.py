"""Sets a program's params for one build: a pass from IR to IR that replaces their defaults.

before: param float margin = 0.5        after `--param margin=0.8`: param float margin = 0.8
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from koordgen.ir.decl import Program
from koordgen.ir.expr import Builtin, Const, Expr, Unary
from koordgen.ir.types import BOOL, FLOAT, INT, POINT, Scalar
from koordgen.node import replace
from koordgen.source import Span

Value = int | float | bool | list[float]


class BadParam(Exception):
    """A value that does not fit its param, or a name that is no param; the message says which."""


def with_params(program: Program, values: Mapping[str, Value]) -> Program:
    """The program with these values as defaults: numbers, booleans, and [x, y, z] in metres for a Point."""
    declared = {p.name: p for p in program.params}
    for name in values:
        if name not in declared:
            known = ", ".join(declared) or "none"
            raise BadParam(f"{program.path} has no param {name!r} (it has: {known})")
    return replace(
        program,
        params=tuple(
            replace(p, default=_constant(p.name, p.type, values[p.name], p.span)) if p.name in values else p
            for p in program.params
        ),
    )


def parse_value(text: str) -> Value:
    """A value as written on the command line: 3, 0.5, true, or x,y,z for a Point. Raises BadParam."""
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    try:
        return int(text)
    except ValueError:
        pass
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        raise BadParam(f"{text!r} is no value: a number, true, false, or x,y,z for a Point") from None
    return numbers[0] if len(numbers) == 1 else numbers


def _constant(name: str, type_: Scalar, value: Value, span: Span) -> Expr:
    def number(of: float) -> Expr:
        if not math.isfinite(of):
            raise BadParam(f"param {name}: {of} is not a finite number")
        literal = Const(abs(of), FLOAT, span)
        return literal if math.copysign(1.0, of) > 0 else Unary("-", literal, FLOAT, span)

    match value, type_:
        case bool(), Scalar("bool"):
            return Const(value, BOOL, span)
        case int(), Scalar("int") if not isinstance(value, bool) and abs(value) < 2**63:
            literal = Const(abs(value), INT, span)
            return literal if value >= 0 else Unary("-", literal, INT, span)
        case int() | float(), Scalar("float") if not isinstance(value, bool) and abs(value) < 1e300:
            return number(float(value))
        case [_, _, _], Scalar("Point"):
            return Builtin("Point", tuple(number(float(v)) for v in value), POINT, span)
    raise BadParam(f"param {name} is of type {type_}; {value!r} does not fit")
