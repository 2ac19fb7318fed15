"""Contradiction file (format `koord-unsound/1`): JSON writer and parser for a run that contradicts a verdict PROVED.

Exact numbers are written as text ("1/3", "sqrt(2)").

The parser does not trust a file, which may belong to another program, be incomplete or be hostile. The parser checks
the program's hash, all names, the types of all values, and limits of size. A file contains no results of steps: the
semantics runs the steps again.
"""

from __future__ import annotations

import json
import math
import re
from base64 import b64decode, b64encode
from collections.abc import Iterable, Mapping
from fractions import Fraction
from typing import Any, NamedTuple

from koordgen.lang.ir import decl
from koordgen.lang.ir.expr import PortCall
from koordgen.lang.ir.tree import walk
from koordgen.lang.ir.types import (
    FLOAT,
    GRID,
    INT,
    PLANNER,
    POINT,
    POSE,
    ExternType,
    MapOf,
    PerRobot,
    RecordType,
    Sequence,
    Sized,
    TupleOf,
    Type,
    list_of,
)
from koordgen.lang.semantics.exact import Root, root
from koordgen.lang.semantics.property import Asked
from koordgen.lang.semantics.state import Robot, State, Store
from koordgen.lang.semantics.values import RecordValue, Value, conforms, encodable
from koordgen.runtime.values.gridmap import GridMap
from koordgen.runtime.values.points import Grid, Opaque, Point, Pose, Scan
from koordgen.verify.attack.judge import COMMANDS, ENVIRONMENT, INIT, Act, Contradiction, Trial, names_of
from koordgen.verify.attack.ports import PortAnswer

FORMAT = "koord-unsound/1"
MOST_BYTES = 4 << 20
MOST_ROBOTS = 4
MOST_ACTS = 64
DIGITS = 1000  # largest number of digits of a number in the file
_NUMBER = re.compile(rf"-?[0-9]{{1,{DIGITS}}}(/[0-9]{{1,{DIGITS}}})?")
_ROOT = re.compile(r"sqrt\((.*)\)", re.DOTALL)
_ANEW = "run `koordgen prove` again: it writes a new file if it finds a contradiction"


class BadFile(Exception):
    """Raised if a contradiction file is invalid. The message is the reason; `help` is advice for the user."""

    def __init__(self, message: str, help: str = _ANEW) -> None:
        super().__init__(message)
        self.help = help


class TrialFile(NamedTuple):
    """Content of a contradiction file.

    `proved`: names of the PROVED invariants.
    `trial`: first state and steps of the run that contradicts a verdict.
    `invariant`: name of the invariant whose verdict is contradicted."""

    proved: tuple[str, ...]
    trial: Trial
    invariant: str


# Writer of a contradiction file


def to_text(found: Contradiction, proved: Iterable[str], program_hash: str, path: str) -> str:
    """Return the text of a contradiction file.

    `proved`: names of the PROVED invariants.
    `program_hash`, `path`: hash and path of the attacked program."""
    state = found.trial.state
    document = {
        "format": FORMAT,
        "program": program_hash,
        "path": path,
        "invariant": found.breach.invariant,
        "why": found.breach.why,
        "proved": sorted(proved),
        "params": _values(state.params),
        "state": {
            "round": state.round,
            "robots": [
                {"locals": _values(r.locals), "ports": _values(r.ports), "stopped": r.stopped} for r in state.robots
            ],
            "slots": {name: [to_json(v) for v in values] for name, values in state.store.slots.items()},
            "cells": _values(state.store.cells),
        },
        "steps": [_step(act) for act in found.trial.acts],
    }
    return json.dumps(document, indent=1, allow_nan=False) + "\n"


def _step(act: Act) -> dict[str, Any]:
    if act.event == ENVIRONMENT:
        return {"event": act.event, "sensors": [_values(new) for new in act.sensors]}
    if act.event == COMMANDS:
        return {"event": act.event, "commands": _values(act.commands)}
    answers = [
        {"robot": pid, "port": port, "arguments": [to_json(arg) for arg in args], "answer": to_json(answer)}
        for pid, (port, args, answer) in act.answers
    ]
    return {"event": act.event, "robot": act.pid, "answers": answers}


def _values(values: Mapping[str, Value]) -> dict[str, Any]:
    return {name: to_json(value) for name, value in values.items()}


def to_json(value: Any) -> Any:
    """Return a Koord value as a JSON value. `read_trial` needs the value's type to convert it back."""
    match value:
        case bool() | int() | str():
            return value
        case Fraction():
            return str(value)
        case Root(square=square):
            return f"sqrt({square})"
        case float():
            return str(Fraction(value)) if math.isfinite(value) else str(value)
        case bytes():
            return b64encode(value).decode()
        case RecordValue(_, fields):
            return [to_json(part) for part in fields]
        case tuple():
            return [to_json(part) for part in value]
        case Point() | Pose() | Grid() | Scan() | GridMap() | Opaque():
            return [to_json(getattr(value, name)) for name in value.__struct_fields__]
        case _:
            raise AssertionError(f"{value!r} is not a value of the language")


# Parser of a contradiction file


def read_trial(data: bytes, program: decl.Program, program_hash: str) -> TrialFile:
    """Parse and check a contradiction file. Raises BadFile if the file is invalid.

    `data`: content of the file.
    `program`: program with exact numbers, to which the file must belong.
    `program_hash`: hash of this program. The file must contain the same hash."""
    if len(data) > MOST_BYTES:
        raise BadFile(f"the file has {len(data)} bytes; the limit is {MOST_BYTES}")
    try:
        document = json.loads(data.decode("utf-8"), parse_constant=_no_constant, object_pairs_hook=_each_once)
    except RecursionError:
        raise BadFile("the file's JSON is nested too deeply") from None
    except ValueError as error:  # ValueError is the base class of UnicodeDecodeError and JSONDecodeError
        raise BadFile(f"the file is not valid JSON: {error}") from None
    file = _TrialReader(program)
    top = file.table(document, "the file", _TOP)
    if top["format"] != FORMAT:
        raise BadFile(f"the file's format is not {FORMAT}")
    if top["program"] != program_hash:
        raise BadFile(
            "the file was written for another program, or for another version of this one",
            "give the program for which the file was written; it must be unchanged, so that its hash is the same",
        )
    proved = file.names(top["proved"], "proved")
    invariant = file.name(top["invariant"], "invariant", proved)
    try:
        return TrialFile(proved, file.trial(top), invariant)
    except RecursionError:
        raise BadFile("a value in the file is nested too deeply") from None


_TOP = ("format", "program", "path", "invariant", "why", "proved", "params", "state", "steps")


def _no_constant(name: str) -> Any:
    raise ValueError(f"{name} is not a number")


def _each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a key occurs twice in one object")
    return found


class _TrialReader:
    """Parser of the objects in a contradiction file. Each method checks its object against the program.

    In all methods, `what` names the object in messages of BadFile."""

    def __init__(self, program: decl.Program) -> None:
        self.program = program
        ports = [(m, p) for m in program.modules for p in m.ports if p.direction in ("sensor", "actuator")]
        self.ports = {f"{m.name}.{p.name}": p.type for m, p in ports}
        self.sensors = {f"{m.name}.{p.name}": p.type for m, p in ports if p.direction == "sensor"}
        commanded = decl.commanded(program)
        self.commands = {v.name: v.type for v in program.shared if v.name in commanded}
        self.called = {
            f"{n.module}.{n.port}": n for n in walk((program.init, program.events)) if isinstance(n, PortCall)
        }
        for function in program.functions:
            self.called.update({f"{n.module}.{n.port}": n for n in walk(function.block) if isinstance(n, PortCall)})

    def table(self, data: Any, what: str, keys: Iterable[str]) -> dict[str, Any]:
        """Return a JSON object of the file. Raises BadFile unless the object's keys are exactly `keys`."""
        if not isinstance(data, dict):
            raise BadFile(f"{what} is not an object")
        wanted = set(keys)
        wrong = sorted(wanted ^ data.keys())
        if wrong:
            raise BadFile(f"{what} {'lacks' if wrong[0] in wanted else 'has an unknown'} {_short(wrong[0])}")
        return data

    def items(self, data: Any, what: str, least: int, most: int) -> list[Any]:
        if not isinstance(data, list) or not least <= len(data) <= most:
            raise BadFile(f"{what} is not a list of {least} to {most} elements")
        return data

    def names(self, data: Any, what: str) -> tuple[str, ...]:
        """Return a list of invariants or loop invariants in the file; refuse names that the program lacks."""
        known = names_of(self.program)
        return tuple([self.name(one, what, known) for one in self.items(data, what, 1, len(known))])

    def name(self, data: Any, what: str, known: Iterable[str]) -> str:
        if not isinstance(data, str) or data not in known:
            raise BadFile(f"{what}: {_short(data)} is none of the allowed names")
        return data

    def whole(self, data: Any, what: str, most: int) -> int:
        if type(data) is not int or not 0 <= data <= most:
            raise BadFile(f"{what}: {_short(data)} is not a whole number from 0 to {most}")
        return data

    def trial(self, top: Mapping[str, Any]) -> Trial:
        params = self.values(top["params"], "params", {p.name: p.type for p in self.program.params})
        table = self.table(top["state"], "the state", ("round", "robots", "slots", "cells"))
        robots = tuple([self.robot(r) for r in self.items(table["robots"], "robots", 1, MOST_ROBOTS)])
        per_robot = {v.name: v.type for v in self.program.shared if v.kind == "allread"}
        slots = self.table(table["slots"], "slots", per_robot)
        store = Store(
            {
                name: tuple(
                    [self.value(v, type_, name) for v in self.items(slots[name], name, len(robots), len(robots))]
                )
                for name, type_ in per_robot.items()
            },
            self.values(table["cells"], "cells", {v.name: v.type for v in self.program.shared if v.kind == "allwrite"}),
        )
        state = State(params, robots, store, self.whole(table["round"], "round", 10**9))
        steps = self.items(top["steps"], "steps", 1, MOST_ACTS)
        return Trial(state, tuple([self.act(step, len(robots)) for step in steps]))

    def robot(self, data: Any) -> Robot:
        table = self.table(data, "a robot", ("locals", "ports", "stopped"))
        if type(table["stopped"]) is not bool:
            raise BadFile("`stopped` of a robot is neither true nor false")
        own = self.values(table["locals"], "locals", {v.name: v.type for v in self.program.locals})
        return Robot(own, self.values(table["ports"], "ports", self.ports), table["stopped"])

    def act(self, data: Any, robots: int) -> Act:
        events = [INIT, ENVIRONMENT, COMMANDS, *[e.name for e in self.program.events]]
        event = self.name(data.get("event") if isinstance(data, dict) else None, "a step's event", events)
        if event == ENVIRONMENT:
            table = self.table(data, "a step", ("event", "sensors"))
            moved = self.items(table["sensors"], "sensors", robots, robots)
            return Act(event, None, tuple([self.values(new, "sensors", self.sensors) for new in moved]))
        if event == COMMANDS:
            table = self.table(data, "a step", ("event", "commands"))
            return Act(event, commands=self.values(table["commands"], "commands", self.commands))
        table = self.table(data, "a step", ("event", "robot", "answers"))
        if event == INIT and table["robot"] is not None:
            raise BadFile("the step `init` is run by all robots, so the step's `robot` must be null")
        pid = None if event == INIT else self.whole(table["robot"], "a step's robot", robots - 1)
        answers = self.items(table["answers"], "answers", 0, 1000)
        return Act(event, pid, (), tuple([self.answer(one, robots) for one in answers]))

    def answer(self, data: Any, robots: int) -> PortAnswer:
        table = self.table(data, "an answer", ("robot", "port", "arguments", "answer"))
        port = self.name(table["port"], "an answer's port", self.called)
        types = [arg.type for arg in self.called[port].args]
        given = self.items(table["arguments"], "arguments", len(types), len(types))
        args = tuple([self.value(one, type_, port) for one, type_ in zip(given, types, strict=True)])
        answer = self.value(table["answer"], self.called[port].type, port)
        return PortAnswer(self.whole(table["robot"], "an answer's robot", robots - 1), Asked(port, args, answer))

    def values(self, data: Any, what: str, types: Mapping[str, Type]) -> dict[str, Value]:
        table = self.table(data, what, types)
        return {name: self.value(table[name], type_, name) for name, type_ in types.items()}

    def value(self, data: Any, type_: Type, name: str) -> Value:
        try:
            value = _value(data, type_)
        except (TypeError, ValueError, LookupError, ArithmeticError):
            raise BadFile(f"{name}: {_short(data)} is not of type {type_}") from None
        if not conforms(value, type_):
            raise BadFile(f"{name}: {_short(data)} is not of type {type_}")
        return value  # type: ignore[no-any-return]


def _value(data: Any, type_: Type) -> Any:
    """Convert a JSON value to a Koord value of the given type.

    Raises TypeError, ValueError, LookupError or ArithmeticError if the JSON value does not fit the type."""
    match type_:
        case Sequence(_, element) | PerRobot(element):
            return tuple([_value(part, element) for part in _list(data)])
        case MapOf(key, held):
            return tuple([_value(pair, TupleOf((key, held))) for pair in _list(data)])
        case TupleOf(parts):
            return tuple([_value(part, own) for part, own in zip(_list(data), parts, strict=True)])
        case RecordType(name, fields):
            parts_ = zip(_list(data), fields, strict=True)
            return RecordValue(name, tuple([_value(part, own) for part, (_, own) in parts_]))
        case ExternType():
            (text,) = _list(data)
            return Opaque(b64decode(text, validate=True))
        case _ if type_ == INT:
            return _whole(data)
        case _ if type_ == FLOAT:
            return _number(data)
        case _ if type_ == POINT:
            x, y, z = _list(data)
            return Point(_number(x), _number(y), _number(z))
        case _ if type_ == POSE:
            position, yaw = _list(data)
            return Pose(_value(position, POINT), _number(yaw))
        case _ if type_ == GRID:
            column, row, size = _list(data)
            return Grid(_whole(column), _whole(row), _number(size))
        case _ if type_ == PLANNER:
            return _value(data, list_of(POINT))
        case Sized("Scan"):
            angles, ranges, most = _list(data)
            return Scan(tuple(map(_float, _list(angles))), tuple(map(_float, _list(ranges))), _float(most))
        case Sized("GridMap"):
            resolution, left, low, width, height, cells = _list(data)
            west, south, wide, high = (_whole(part) for part in (left, low, width, height))
            return GridMap(_float(resolution), west, south, wide, high, b64decode(cells, validate=True))
        case _:
            if isinstance(data, str) and not encodable(data):
                raise ValueError
            return data


def _list(data: Any) -> list[Any]:
    if not isinstance(data, list):
        raise TypeError
    return data


def _whole(data: Any) -> int:
    if type(data) is not int or abs(data) >= 10**DIGITS:
        raise TypeError
    return data


def _number(data: Any) -> Any:
    """Return the exact number that a text such as "1/3" or "sqrt(2)" denotes. Raises TypeError, ValueError."""
    if not isinstance(data, str) or len(data) > 2 * DIGITS + 20:
        raise TypeError
    if data in ("inf", "-inf", "nan"):
        return float(data)
    inner = _ROOT.fullmatch(data)
    text = inner.group(1) if inner else data
    if not _NUMBER.fullmatch(text):
        raise ValueError
    return root(Fraction(text)) if inner else Fraction(text)


def _float(data: Any) -> float:
    return float(_number(data))


def _short(data: Any) -> str:
    """Return a JSON value as text of at most 60 characters for an error message."""
    text = json.dumps(data)  # JSON escapes control characters and lone surrogates, so the text can be printed
    return text if len(text) <= 60 else f"{text[:57]}..."
