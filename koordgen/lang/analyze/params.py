"""Params of a build: a pass from IR to IR that replaces the defaults of a program's params.

before: param float margin = 0.5        after `--param margin=0.8`: param float margin = 0.8
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping

from koordgen.lang.analyze.rules.first_value import flaw_of
from koordgen.lang.ir.capacity import excess
from koordgen.lang.ir.decl import Local, Program, Record, Shared
from koordgen.lang.ir.expr import Builtin, Const, Expr, Make, Unary
from koordgen.lang.ir.types import (
    BOOL,
    FLOAT,
    GRID,
    INT,
    POINT,
    POSE,
    STRING,
    MapOf,
    RecordType,
    Scalar,
    Sequence,
    Sized,
    TupleOf,
    Type,
)
from koordgen.lang.node import replace
from koordgen.lang.source import Span

# Type of the values that the parsers of YAML and JSON return.
Value = int | float | bool | str | list["Value"] | dict["Value", "Value"]


class BadParam(Exception):
    """Raised if a value does not fit its param, or if a name is no param of the program."""


def with_params(program: Program, values: Mapping[str, Value]) -> Program:
    """Return the program with these values as the defaults of its params. Raises BadParam.

    Accepted values are numbers, booleans and strings; [x, y, z] in metres for a Point, [position, yaw] for a Pose, and
    [x, y, size] for a Grid; lists for List, Queue, Set and tuples; a dict, or a list of pairs, for a Map; a dict by
    field name for a record, whose missing fields keep their initial values.
    """
    declared = {p.name: p for p in program.params}
    for name in values:
        if name not in declared:
            known = ", ".join(declared) or "none"
            raise BadParam(f"{program.path} has no param {name!r} (it has: {known})")
    records = {record.type.name: record for record in program.records}
    params = [
        replace(p, default=_Reader(records, p.span).top(p.name, p.type, values[p.name])) if p.name in values else p
        for p in program.params
    ]
    firsts = {p.name: p.default for p in params}
    variables: tuple[Local | Shared, ...] = (*program.locals, *program.shared)
    for variable in variables:
        wrong = flaw_of(variable.initial, variable.type, firsts)
        if wrong is not None:
            raise BadParam(f"with these params the initial value of {variable.name} {wrong.reason}")
    return replace(program, params=tuple(params))


def as_given(value: Value, type_: Type) -> Value:
    """Convert a value from a trace to the form that `with_params` accepts.

    In a trace a record is written as a list of the values of its fields.
    """
    match type_, value:
        case RecordType(_, fields), list():
            return {name: as_given(part, field) for part, (name, field) in zip(value, fields, strict=True)}
        case Sequence(_, element), list():
            return [as_given(part, element) for part in value]
        case MapOf(key, held), list():
            return [as_given(pair, TupleOf((key, held))) for pair in value]
        case TupleOf(items), list():
            return [as_given(part, item) for part, item in zip(value, items, strict=True)]
        case _:
            return value


def parse_value(text: str) -> Value:
    """Parse a value from the command line: 3, 0.5, true, `x,y,z` for a Point, JSON for a value with parts.

    Any other text is a string. Raises BadParam if JSON is malformed.
    """
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    if text[:1] in ("[", "{", '"'):
        try:
            value: Value = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise BadParam(f"{text!r} is not JSON: {error}") from None
        return value
    for convert in (int, float):
        try:
            return convert(text)
        except ValueError:
            pass
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        return text


class _Reader:
    """Converter of values to constants of the IR.

    In messages, `what` names the part of the param that is converted: `param tasks[2].target`.
    """

    def __init__(self, records: Mapping[str, Record], span: Span) -> None:
        self.records = records
        self.span = span

    def top(self, name: str, type_: Type, value: Value) -> Expr:
        made = self.constant(f"param {name}", type_, value)
        too_much = excess(made, type_)
        if too_much:
            raise BadParam(f"param {name} has {too_much}")
        return made

    def constant(self, what: str, type_: Type, value: Value) -> Expr:
        match type_:
            case Scalar() | Sized("string"):
                return self.scalar(what, type_, value)
            case Sequence(name, element) if isinstance(value, list):
                items = [self.constant(f"{what}[{i}]", element, item) for i, item in enumerate(value)]
                self.distinct(what, items if name == "Set" else ())
                return Make(tuple(items), type_, self.span)
            case MapOf(key, held) if isinstance(value, (dict, list)):
                pair = TupleOf((key, held))
                pairs = [list(item) for item in value.items()] if isinstance(value, dict) else value
                entries = [self.constant(f"{what}[{i}]", pair, item) for i, item in enumerate(pairs)]
                self.distinct(what, [e.items[0] for e in entries if isinstance(e, Make)])
                return Make(tuple(entries), type_, self.span)
            case TupleOf(items) if isinstance(value, list) and len(value) == len(items):
                parts = [
                    self.constant(f"{what}[{i}]", part, item)
                    for i, (part, item) in enumerate(zip(items, value, strict=True))
                ]
                return Make(tuple(parts), type_, self.span)
            case RecordType() if isinstance(value, dict):
                return self.record(what, type_, value)
            case _:
                raise wrong_type(what, type_, value)

    def record(self, what: str, type_: RecordType, value: dict[Value, Value]) -> Expr:
        fields = dict(type_.fields)
        for name in value:
            if name not in fields:
                raise BadParam(f"{what}: a {type_} has no field {name!r} (it has: {', '.join(fields)})")
        items = [
            self.constant(f"{what}.{name}", field, value[name]) if name in value else first
            for (name, field), first in zip(type_.fields, self.records[type_.name].defaults, strict=True)
        ]
        return Make(tuple(items), type_, self.span)

    def scalar(self, what: str, type_: Type, value: Value) -> Expr:
        match value, str(type_):
            case bool(), "bool":
                return Const(value, BOOL, self.span)
            case int(), "int" if not isinstance(value, bool) and abs(value) < 2**63:
                literal = Const(abs(value), INT, self.span)
                return literal if value >= 0 else Unary("-", literal, INT, self.span)
            case int() | float(), "float" if not isinstance(value, bool) and not abs(value) >= 1e300:
                return self.number(what, float(value))
            case str(), "string":
                return Const(value, STRING, self.span)
            case [x, y, z], "Point":
                return Builtin("Point", self.parts(what, (FLOAT, FLOAT, FLOAT), (x, y, z)), POINT, self.span)
            case [x, y, size], "Grid":
                return Builtin("Grid", self.parts(what, (INT, INT, FLOAT), (x, y, size)), GRID, self.span)
            case [position, yaw], "Pose":
                return Builtin("Pose", self.parts(what, (POINT, FLOAT), (position, yaw)), POSE, self.span)
        raise wrong_type(what, type_, value)

    def parts(self, what: str, types: tuple[Type, ...], values: tuple[Value, ...]) -> tuple[Expr, ...]:
        named = enumerate(zip(types, values, strict=True))
        return tuple([self.constant(f"{what}[{i}]", type_, value) for i, (type_, value) in named])

    def number(self, what: str, value: float) -> Expr:
        if not math.isfinite(value):
            raise BadParam(f"{what}: {value} is not a finite number")
        literal = Const(abs(value), FLOAT, self.span)
        return literal if math.copysign(1.0, value) > 0 else Unary("-", literal, FLOAT, self.span)

    def distinct(self, what: str, items: Iterable[Expr]) -> None:
        seen: set[Expr] = set()
        for item in items:
            if item in seen:
                raise BadParam(f"{what} has an element that occurs twice")
            seen.add(item)


def wrong_type(what: str, type_: Type, value: Value) -> BadParam:
    """Return the error for a value of the wrong type. Its message shows how to write a value of the right type."""
    form = _form(type_)
    return BadParam(f"{what} is of type {type_}{form and f', written {form}'}; {value!r} does not fit")


def _form(type_: Type) -> str:
    match type_:
        case Sequence():
            return "[a, b, ...]"
        case MapOf():
            return "{key: value, ...} or [[key, value], ...]"
        case TupleOf(items):
            return f"[{', '.join(map(str, items))}]"
        case RecordType(_, fields):
            return f"{{{', '.join(f'{name}: {field}' for name, field in fields)}}}"
        case _:
            forms = {"string": '"..."', "Point": "[x, y, z]", "Pose": "[[x, y, z], yaw]", "Grid": "[x, y, size]"}
            return forms.get(str(type_), "")
