"""Extern functions of a program, which the semantics calls through the robots' generated code."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import util
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import ModuleType
from typing import Any

from koordgen.build.emit.names import Names
from koordgen.build.emit.program import functions_module, program_text
from koordgen.lang.ir import decl
from koordgen.lang.ir.types import MapOf, PerRobot, RecordType, Sequence, TupleOf, Type
from koordgen.lang.semantics.values import RecordValue, Value


class CannotCall(Exception):
    """Raised if the file with the extern functions cannot be used. The message gives the reason."""


def externs(program: decl.Program, file: Path | None) -> Mapping[str, Callable[..., Value]]:
    """Return the extern functions by name, loaded from the user's file. Raises CannotCall."""
    if not program.externs:
        return {}
    if file is None or not file.is_file():
        raise CannotCall(
            f"{file or functions_module(program) + '.py'}, the file with the extern functions, does not exist"
        )
    load(program, file)
    names = Names(program)
    # Python resolves the annotations of record classes in this module.
    name = f"replayed_{functions_module(program)}"
    module = sys.modules[name] = ModuleType(name)
    vars(module)["__file__"] = "program.py"
    exec(compile(program_text(program), "program.py", "exec"), vars(module))
    return {f.name: _called(f, vars(module), names) for f in program.externs}


def load(program: decl.Program, file: Path) -> None:
    """Import the user's file under the module name that generated code imports. Raises CannotCall."""
    name = functions_module(program)
    # The explicit loader accepts a file with any suffix.
    spec = util.spec_from_file_location(name, file, loader=SourceFileLoader(name, str(file)))
    assert spec is not None and spec.loader is not None
    module = sys.modules[name] = util.module_from_spec(spec)
    sys.path.insert(0, str(file.parent))
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise CannotCall(f"{file} cannot be imported: {type(error).__name__}: {error}") from error
    finally:
        sys.path.remove(str(file.parent))
    missing = [f.name for f in program.externs if not callable(getattr(module, f.name, None))]
    if missing:
        raise CannotCall(f"{file} lacks {', '.join(missing)}, which the program declares as extern")


def _called(function: decl.ExternFunction, scope: Mapping[str, Any], names: Names) -> Callable[..., Value]:
    wrapped = scope[names.calls[function.name]]

    def call(*args: Value) -> Value:
        types = [parameter.type for parameter in function.parameters]
        return semantic_value(
            wrapped(*[python_value(a, t, scope, names) for a, t in zip(args, types, strict=True)]), function.result
        )

    return call


def python_value(value: Any, type_: Type, scope: Mapping[str, Any], names: Names) -> Any:
    """Convert a value of the semantics to the form that robots use.

    Robots represent records as objects of the program's classes."""
    match type_:
        case RecordType(name, fields):
            parts = zip(value.fields, fields, strict=True)
            return scope[names.records[name]](*[python_value(part, t, scope, names) for part, (_, t) in parts])
        case Sequence(_, element) | PerRobot(element):
            return tuple([python_value(part, element, scope, names) for part in value])
        case MapOf(key, held):
            return tuple([(python_value(k, key, scope, names), python_value(v, held, scope, names)) for k, v in value])
        case TupleOf(items):
            return tuple([python_value(part, t, scope, names) for part, t in zip(value, items, strict=True)])
        case _:
            return value


def semantic_value(value: Any, type_: Type) -> Value:
    match type_:
        case RecordType(name, fields):
            parts = [getattr(value, field) for field in value.__struct_fields__]
            return RecordValue(name, tuple([semantic_value(p, t) for p, (_, t) in zip(parts, fields, strict=True)]))
        case Sequence(_, element) | PerRobot(element):
            return tuple([semantic_value(part, element) for part in value])
        case MapOf(key, held):
            return tuple([(semantic_value(k, key), semantic_value(v, held)) for k, v in value])
        case TupleOf(items):
            return tuple([semantic_value(part, t) for part, t in zip(value, items, strict=True)])
        case _:
            found: Value = value
            return found
