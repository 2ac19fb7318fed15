"""Generated code of a program's properties, and the conversion of trace values for this code.

Simulators and robots run the same generated code.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

from koordgen.build.emit.names import Names
from koordgen.build.emit.program import functions_module, program_text
from koordgen.build.emit.property import properties_text
from koordgen.lang.ir import decl
from koordgen.lang.ir.types import GRID, POINT, Type, list_of
from koordgen.lang.semantics.exec import declared
from koordgen.runtime.program.extern import BadExtern
from koordgen.runtime.program.property import UNKNOWN, Properties
from koordgen.runtime.values.points import Point
from koordgen.verify.prove.report.table import shown
from koordgen.verify.replay.functions import CannotCall, load, python_value, semantic_value
from koordgen.verify.replay.values import BadValue, from_trace

# types of the arguments of a path planner: a goal, and obstacles as grid cells
ASKED: tuple[Type, ...] = (POINT, list_of(GRID))


class GeneratedProperties:
    """Generated properties of one program.

    `types`: name of a variable or port -> type.
    `functions`: the user's file with the extern functions of the program. Raises CannotCall if the program has extern
        functions and the file cannot be loaded."""

    def __init__(self, program: decl.Program, functions: Path | None) -> None:
        self.program = program
        self.types: dict[str, Type] = declared(program)
        self._names = Names(program)
        if program.externs:
            if functions is None or not functions.is_file():
                missing = functions or f"{functions_module(program)}.py"
                raise CannotCall(f"{missing}, the file with the extern functions, does not exist")
            load(program, functions)
        # Python looks up the annotations of record classes in this module
        name = f"audited_{functions_module(program)}"
        module = sys.modules[name] = ModuleType(name)
        self._scope: dict[str, Any] = vars(module)
        self._scope["__file__"] = "program.py"
        exec(compile(program_text(program), "program.py", "exec"), self._scope)
        with _as_program(module):
            properties: dict[str, Any] = {"__name__": "properties"}
            exec(compile(properties_text(program), "properties.py", "exec"), properties)
        self.found: Properties = properties["PROPERTIES"]
        if program.externs:
            try:
                self._scope["LIBRARY"].load()
            except BadExtern as error:
                raise CannotCall(str(error)) from None

    def value(self, name: str, data: Any) -> Any:
        """Convert the value of a variable or port from a trace to the form that generated code reads.

        Returns UNKNOWN if the value is missing, if it is null (traces write null for numbers that are not finite), or
        if it does not have the type of the variable or port."""
        return UNKNOWN if data is UNKNOWN else self._of(data, self.types[name]) if name in self.types else UNKNOWN

    def values(self, group: Mapping[str, Any]) -> dict[str, Any]:
        return {name: self.value(name, data) for name, data in group.items()}

    def call(self, port: str, args: list[Any], answer: Any) -> tuple[str, tuple[Any, ...], Any]:
        """Convert a call of a callable port from a trace. Returns the port, the arguments and the answer."""
        given = tuple([self._of(arg, type_) for arg, type_ in zip(args, ASKED, strict=False)])
        return port, given, self.value(port, answer)

    def text(self, name: str, value: Any) -> str:
        """Return the value of a variable or port as Koord text, with floats rounded to six significant digits."""
        if value is UNKNOWN:
            return "unknown"
        type_ = self.types.get(name)
        return shown(_short(semantic_value(value, type_) if type_ is not None else value))

    def _of(self, data: Any, type_: Type) -> Any:
        try:
            if _hidden(data):
                return UNKNOWN
            return python_value(from_trace(data, type_), type_, self._scope, self._names)
        except (BadValue, RecursionError, OverflowError):
            return UNKNOWN


@contextmanager
def _as_program(module: ModuleType) -> Iterator[None]:
    before = sys.modules.get("program")
    sys.modules["program"] = module
    try:
        yield
    finally:
        if before is None:
            del sys.modules["program"]
        else:
            sys.modules["program"] = before


def _hidden(data: Any) -> bool:
    return data is None or (isinstance(data, list) and any(map(_hidden, data)))


def _short(value: Any) -> Any:
    """Return a value in which all floats are rounded to six significant digits."""
    match value:
        case float():
            return float(f"{value:.6g}")
        case Point(x, y, z):
            return Point(_short(x), _short(y), _short(z))
        case tuple():
            parts = [_short(part) for part in value]
            return tuple(parts) if type(value) is tuple else type(value)(*parts)
        case _:
            return value
