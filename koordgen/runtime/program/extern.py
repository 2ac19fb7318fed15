"""Calls of extern functions: safe arguments, strict conversion of results, and one exception for all errors.

An extern function cannot change the program's values: Koord values are immutable, and values of extern types are
decoded anew for every call. Every exception of user code becomes a BadExtern."""

from __future__ import annotations

import importlib
import reprlib
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import msgspec

from koordgen.runtime.values.bounds import Blob, Bound, Cells, Distinct, Many, Pairs, Parts, Text, parts_of
from koordgen.runtime.values.containers import map_of, set_of
from koordgen.runtime.values.gridmap import GridMap, sound
from koordgen.runtime.values.points import Opaque

# Exceptions that user code may raise, and that must not end the agent.
ESCAPES = (Exception, SystemExit, KeyboardInterrupt, GeneratorExit)


class Contract(NamedTuple):
    """Broken contract of an extern function: kind of the contract, name of the function, line in the program."""

    of: Literal["requires", "ensures"]
    name: str
    line: int


class BadExtern(Exception):
    """Raised if a call of an extern function failed.

    The function is missing, raised an exception, returned an invalid value, or broke its contract. `contract` is the
    broken contract, or None."""

    def __init__(self, message: str, contract: Contract | None = None) -> None:
        super().__init__(message)
        self.contract = contract


class Library:
    """Python module with the user's extern functions and types. It is imported at the first use, or by `load`."""

    def __init__(self, module: str) -> None:
        self._name = module
        self._module: Any = None

    def load(self) -> None:
        """Import the user's module. Raises BadExtern."""
        if self._module is None:
            try:
                self._module = importlib.import_module(self._name)
            except ESCAPES as error:
                raise BadExtern(f"{self._name}.py cannot be imported: {_error_text(error)}") from error

    def find(self, name: str) -> Callable[..., Any]:
        """Return a function or class of the user's module. Raises BadExtern if it is missing."""
        self.load()
        found = getattr(self._module, name, None)
        if not callable(found):
            raise BadExtern(f"{self._name}.py has no {name}")
        return found  # type: ignore[no-any-return]


class Extern:
    """Extern function that a program can call.

    `parameters` and `result`: size limits that follow the function's Koord types. `type`: Python type of the result.
    `wanted`: name of the result's type in messages, such as "a List<Point>"."""

    def __init__(
        self, library: Library, name: str, parameters: tuple[Bound, ...], result: Bound, type: Any, wanted: str
    ) -> None:
        self._library = library
        self._name = name
        self._parameters = parameters
        self._result = result
        self._type = type
        self._wanted = wanted

    def __call__(self, *args: Any) -> Any:
        """Call the extern function, and return the result as a Koord value. Raises BadExtern."""
        function = self._library.find(self._name)
        given = [self._opened(bound, value) for bound, value in zip(self._parameters, args, strict=True)]
        try:
            found = function(*given)
        except ESCAPES as error:
            raise BadExtern(f"{self._name} raised {_error_text(error)}") from error
        try:
            plain = msgspec.to_builtins(self._closed(self._result, found), builtin_types=(bytes,))
            return msgspec.convert(plain, self._type, strict=True)
        except (ValueError, TypeError, LookupError, AttributeError, RecursionError, OverflowError):
            raise BadExtern(f"{self._name} returned {shown(found)}, not {self._wanted}") from None

    def require(self, holds: bool, line: int) -> None:
        """Raise BadExtern unless a precondition of the extern function holds. `line`: its line in the program."""
        if not holds:
            why = f"{self._name} was called although its precondition (line {line}) does not hold"
            raise BadExtern(why, Contract("requires", self._name, line))

    def ensure(self, holds: bool, line: int, result: object) -> None:
        """Raise BadExtern unless a postcondition of the extern function holds. `line`: its line in the program."""
        if not holds:
            why = f"{self._name} returned {shown(result)}, which breaks its postcondition (line {line})"
            raise BadExtern(why, Contract("ensures", self._name, line))

    def _opened(self, bound: Bound, value: Any) -> Any:
        """Convert a Koord value to an argument of the user's function: Opaques become objects of the user's classes."""
        match bound:
            case Blob(_, name):
                return self._made(name, value)
            case Many(_, element) | Distinct(_, element) if _holds_blob(element):
                return tuple(self._opened(element, v) for v in value)
            case Pairs(_, _, held) if _holds_blob(held):
                return tuple((k, self._opened(held, v)) for k, v in value)
            case Parts(items) if any(map(_holds_blob, items)):
                parts = [self._opened(b, v) for b, v in zip(items, parts_of(value), strict=True)]
                return tuple(parts) if isinstance(value, tuple) else type(value)(*parts)
            case _:
                return value

    def _made(self, name: str, value: Opaque) -> Any:
        cls: Any = self._library.find(name)
        try:
            return msgspec.msgpack.decode(value.data, type=cls) if value.data else cls()
        except ESCAPES as error:
            raise BadExtern(f"no {name} can be made for {self._name}: {_error_text(error)}") from error

    def _closed(self, bound: Bound, value: Any) -> Any:
        """Convert a result of the user's function to Koord values.

        Sets and maps are sorted, and objects of the user's classes become Opaques. A value of a wrong type may be
        returned unchanged, because the later conversion to `type` reports it. Raises ValueError or TypeError."""
        match bound:
            case Blob(_, name):
                if not isinstance(value, self._library.find(name)):  # type: ignore[arg-type]
                    raise TypeError
                return Opaque(msgspec.msgpack.encode(value))
            case Many(_, element) if isinstance(value, (list, tuple)):
                return tuple(self._closed(element, v) for v in value)
            case Distinct(_, element) if isinstance(value, (list, tuple, set, frozenset)):
                return set_of(self._closed(element, v) for v in value)
            case Pairs(_, key, held) if isinstance(value, (list, tuple, dict)):
                pairs = value.items() if isinstance(value, dict) else value
                return map_of((self._closed(key, k), self._closed(held, v)) for k, v in pairs)
            case Parts(items, fields):
                parts = _items(value, fields)
                return tuple(self._closed(b, v) for b, v in zip(items, parts, strict=True))
            case Cells() if not (isinstance(value, GridMap) and sound(value)):
                raise ValueError
            case Text():
                value.encode()  # UnicodeEncodeError is a ValueError
                return value
            case _:
                return value


def _items(value: Any, fields: tuple[str, ...]) -> tuple[Any, ...]:
    """Return the items of a tuple or the fields of a record from a sequence, a dict or an object.

    The keys of the dict, or the attributes of the object, are `fields`."""
    if isinstance(value, (list, tuple)):
        return tuple(value)
    if not fields or (isinstance(value, dict) and value.keys() != set(fields)):
        raise TypeError
    return tuple(value[f] if isinstance(value, dict) else getattr(value, f) for f in fields)


def _holds_blob(bound: Bound) -> bool:
    match bound:
        case Many(_, element) | Distinct(_, element) | Pairs(_, _, element):
            return _holds_blob(element)
        case Parts(items):
            return any(map(_holds_blob, items))
        case _:
            return isinstance(bound, Blob)


def shown(value: object) -> str:
    """Return a short text of a value, even if the `__repr__` of a user's class raises an exception."""
    try:
        return reprlib.repr(value)
    except ESCAPES:
        return f"a {type(value).__name__}"


def _error_text(error: BaseException) -> str:
    try:
        return f"{type(error).__name__}: {error}"
    except ESCAPES:
        return type(error).__name__
