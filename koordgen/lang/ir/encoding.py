"""Canonical encoding of the IR: bytes that depend only on a program's meaning.

Its digest is the program's hash. It does not depend on names of classes, fields and modules: LAYOUTS gives every node
kind a tag byte and the
order of its fields. A renamed class, a reordered field or a new mark therefore changes no program's hash. A change of
this form, such as a new field with a meaning, raises VERSION and gives all programs a new hash.

An encoding is HEADER, the version, and then the items given. An item begins with a byte that names its kind:

    00        None: an absent item, or a capacity that does not count
    01, 02    False, True
    03        int: length, two's complement, big-endian, in as few bytes as possible
    04        float: 8 bytes, IEEE 754 binary64, big-endian (0.0 and -0.0 differ)
    05        string: length, UTF-8 (a lone surrogate as its three bytes)
    06        tuple: count, the items
    07        name of a temporary: its number
    08        word of the compiler: its code in WORDS
    10 to 7f  node: the fields that LAYOUTS names for this tag, in that order

Lengths, counts, numbers and codes are 4 bytes, big-endian.

Not encoded:

- `span` and `Program.path`: positions in the source.
- `proved` (SlotRead, Binary, At, Slice): a mark of the analysis. A failed check discards the event; a check that
  cannot fail may be left out.
- `type` of expressions, except of Make and TempRead: the verifier (verify.py) derives it from the operands and the
  declarations, and refuses a node that claims another.
- Capacities outside of declarations: like spans they do not count in the equality of types. They count in params,
  records, ports, shared and local variables, parameters and results.
- Names of temporaries: variables of blocks, loops and quantifiers, and parameters. They are numbered in the order in
  which the walk reaches them, anew in each function, contract, property, assumption, event and `init`. Nothing outside
  of that scope can name them. The names of an extern function's parameters count: the functions file must repeat them.

Every other name counts. Shared variables, record fields, params and ports are visible to peers, to the functions file
or to the settings; local variables, events and properties in traces; functions in tracebacks.

Different programs have different encodings. The first byte of an item gives its kind, and the kind gives its extent: a
fixed number of bytes, a length or count that comes first, or a fixed sequence of items. By induction over the size no
item's bytes begin with those of another item, so bytes can be divided into items in one way only. Each item has one
value: a tag names one node kind, and the forms of plain values are one to one. Numbers of temporaries are one to one
with names inside a scope, where the verifier ensures that names are unique. So two trees with equal bytes differ at
most in what is not encoded.
"""

from __future__ import annotations

from collections.abc import Iterable
from struct import pack
from typing import Any, Final

from koordgen.lang.ir import decl, expr, stmt, types
from koordgen.lang.node import Node

VERSION: Final = 2
HEADER: Final = b"koord-ir\0"

# A field's sign determines its encoding: `~` a temporary's name (or a tuple of them), `:` a type (or a tuple of them)
# whose capacities do not count, `^` a capacity, `=` a word that may be one of WORDS. A field without a sign is encoded
# as an item. A tag is never used again for another kind of node.
LAYOUTS: Final[dict[type, tuple[int, str]]] = {
    types.Scalar: (0x10, "name"),
    types.Sized: (0x11, "name ^capacity"),
    types.Sequence: (0x12, "name element ^capacity"),
    types.MapOf: (0x13, "key value ^capacity"),
    types.TupleOf: (0x14, "items"),
    types.RecordType: (0x15, "name fields"),
    types.ExternType: (0x16, "name"),
    types.PerRobot: (0x17, "element"),
    expr.Const: (0x20, "value"),
    expr.Pid: (0x21, ""),
    expr.NSys: (0x22, ""),
    expr.Ids: (0x23, ""),
    expr.ParamRead: (0x24, "name"),
    expr.LocalRead: (0x25, "name"),
    expr.TempRead: (0x26, "~name :type"),
    expr.SlotRead: (0x27, "name index"),
    expr.SlotsRead: (0x28, "name"),
    expr.SharedRead: (0x29, "name"),
    expr.PortRead: (0x2A, "module port primed"),
    expr.LocalOf: (0x2B, "name robot"),
    expr.PortOf: (0x2C, "module port robot"),
    expr.Widen: (0x2D, "operand"),
    expr.Unary: (0x2E, "op operand"),
    expr.Binary: (0x2F, "op left right"),
    expr.Compare: (0x30, "op left right"),
    expr.Contains: (0x31, "item values"),
    expr.Logic: (0x32, "op left right"),
    expr.Conditional: (0x33, "condition then orelse"),
    expr.Quantified: (0x34, "kind ~name domain body"),
    expr.Range: (0x35, "start stop step"),
    expr.Make: (0x36, ":type items"),
    expr.Field: (0x37, "operand name"),
    expr.Item: (0x38, "operand index"),
    expr.At: (0x39, "operand index"),
    expr.Slice: (0x3A, "operand start stop"),
    expr.With: (0x3B, "operand name value"),
    expr.Builtin: (0x3C, "=name args"),
    expr.Call: (0x3D, "name args"),
    expr.ExternCall: (0x3E, "name args"),
    expr.PortCall: (0x3F, "module port args"),
    stmt.LocalPlace: (0x50, "name"),
    stmt.OwnSlot: (0x51, "name"),
    stmt.SharedPlace: (0x52, "name"),
    stmt.PortPlace: (0x53, "module port"),
    stmt.TempPlace: (0x54, "~name"),
    stmt.Assign: (0x58, "place value"),
    stmt.Let: (0x59, "~name :type value"),
    stmt.If: (0x5A, "condition then orelse"),
    stmt.LoopInvariant: (0x5B, "formula"),
    stmt.For: (0x5C, "~names :types values invariants block"),
    stmt.While: (0x5D, "condition invariants block"),
    stmt.Break: (0x5E, ""),
    stmt.Continue: (0x5F, ""),
    stmt.Return: (0x60, "value"),
    stmt.Emit: (0x61, "module port items"),
    stmt.Stop: (0x62, ""),
    decl.Param: (0x70, "name type default"),
    decl.Record: (0x71, "type defaults"),
    decl.Parameter: (0x72, "~name type"),
    decl.Function: (0x73, "name parameters result block"),
    decl.ExternFunction: (0x74, "name parameters result requires ensures"),
    decl.ExternTypeDef: (0x75, "name"),
    decl.SpecFunction: (0x76, "name parameters result"),
    decl.Port: (0x77, "name type =direction meaning"),
    decl.Meaning: (0x7F, "is_position held clears"),
    decl.Assumption: (0x78, "formula"),
    decl.Module: (0x79, "name ports assumptions"),
    decl.Shared: (0x7A, "name kind type initial"),
    decl.Local: (0x7B, "name type initial"),
    decl.Event: (0x7C, "name guard effect lock priority"),
    decl.Property: (0x7D, "kind name formula"),
    decl.Guarantee: (0x65, "name ~before ~after formula"),
    decl.Export: (0x66, "variable is_written guarantees"),
    decl.Provided: (0x69, "port value"),
    decl.Provides: (0x6A, "name ports"),
    decl.Import: (0x67, "name variables slots written specs"),
    # `init` comes first, because the temporaries of the program's own scope are those of `init`.
    decl.Program: (
        0x7E,
        "name init records extern_types functions externs specs params modules shared locals locks events properties",
    ),
}

# Tag of a program with exports or imports, and the fields that it has after those in LAYOUTS.
CONNECTED: Final = 0x68, "exports imports"
# Likewise for a program that provides modules.
PROVIDING: Final = 0x6B, "exports imports provides"

# Words that no Koord program contains: directions of ports, and updates of values (ir/builtins.py). All others (names
# of types, operators, builtin functions, kinds of properties) are words of the language and encoded as strings.
WORDS: Final[dict[str, int]] = {
    "sensor": 1, "actuator": 2, "callable": 3, "stream": 4,
    "updated": 16, "appended": 17, "extended": 18, "inserted": 19, "removed": 20, "without": 21, "popped": 22,
    "cleared": 23, "set_with": 24, "set_without": 25, "map_at": 26, "map_with": 27, "map_without": 28,
}  # fmt: skip

_SCOPES: Final = (
    decl.Program, decl.Function, decl.ExternFunction, decl.SpecFunction, decl.Assumption, decl.Event, decl.Property,
    decl.Guarantee, decl.Provided,
)  # fmt: skip

_Item = Node | tuple[Any, ...] | str | int | float | None


def encode(*items: _Item) -> bytes:
    """Return the canonical encoding of nodes, tuples and plain values.

    Nodes outside of any scope are in a common one. Raises TypeError for a value of any other type, subclasses included.
    """
    writer = _Writer(sizes=True)
    writer.write(items)
    return HEADER + _number(VERSION) + bytes(writer.out)


def _number(value: int) -> bytes:
    return value.to_bytes(4, "big")


def _compiled(entry: tuple[int, str], node: type) -> tuple[int, bool, tuple[tuple[str, str], ...]]:
    """Return a compiled layout: tag, whether the node begins a scope, fields with their signs in reverse."""
    tag, layout = entry
    fields = [(field.lstrip("~:^="), field[0] if field[0] in "~:^=" else "") for field in layout.split()]
    return tag, node in _SCOPES, tuple(reversed(fields))


_COMPILED = {node: _compiled(entry, node) for node, entry in LAYOUTS.items()}
_CONNECTED, _PROVIDING = [
    _compiled((tag, f"{LAYOUTS[decl.Program][1]} {more}"), decl.Program) for tag, more in (CONNECTED, PROVIDING)
]


def _string(value: str) -> bytes:
    data = value.encode("utf-8", "surrogatepass")
    return b"\5" + _number(len(data)) + data


def _plain(value: object) -> bytes:
    """Encode a value without parts. Tests exact classes, because True is also an int."""
    kind = type(value)
    if value is None:
        return b"\0"
    if kind is bool:
        return b"\2" if value else b"\1"
    if isinstance(value, int):
        data = value.to_bytes(value.bit_length() // 8 + 1, "big", signed=True)
        return b"\3" + _number(len(data)) + data
    if kind is float:
        return b"\4" + pack(">d", value)
    raise TypeError(f"{kind.__name__} has no canonical encoding")


class _Writer:
    """Writer of one encoding. `sizes`: whether capacities count.

    It walks in pre-order without recursion, because a chain of `elif` is nested as deeply as a program is long.
    """

    def __init__(self, sizes: bool) -> None:
        self.out = bytearray()
        self._sizes = sizes
        self._temps: dict[str, int] = {}  # numbers of the current scope's temporaries
        self._types: dict[int, bytes] = {}  # `id` of a type, which the tree keeps alive -> its encoding
        self._strings: dict[str, bytes] = {}

    def write(self, items: Iterable[_Item]) -> None:
        out, strings = self.out, self._strings
        pending: list[Any] = list(reversed(tuple(items)))
        while pending:
            item = pending.pop()
            kind = type(item)
            if kind is str:
                out += strings.get(item) or strings.setdefault(item, _string(item))
            elif kind is bytes:  # already encoded
                out += item
            elif kind is tuple:
                out += b"\6" + _number(len(item))
                pending.extend(reversed(item))
            elif (layout := _COMPILED.get(kind)) is not None:
                if kind is decl.Program and (item.exports or item.imports or item.provides):
                    layout = _PROVIDING if item.provides else _CONNECTED
                tag, scope, fields = layout
                out.append(tag)
                if scope:
                    self._temps = {}
                if kind is decl.ExternFunction:
                    out += self._names(item.parameters)
                for field, sign in fields:
                    value = getattr(item, field)
                    pending.append(self._signed(sign, value) if sign else value)
            else:
                out += _plain(item)

    def _names(self, parameters: tuple[decl.Parameter, ...]) -> bytes:
        """Encode the names of an extern function's parameters, as a tuple of strings."""
        return b"\6" + _number(len(parameters)) + b"".join([_string(parameter.name) for parameter in parameters])

    def _signed(self, sign: str, value: Any) -> bytes:
        if type(value) is tuple:
            return b"\6" + _number(len(value)) + b"".join([self._signed(sign, part) for part in value])
        if sign == "~":
            return b"\7" + _number(self._temps.setdefault(value, len(self._temps)))
        if sign == ":":
            found = self._types.get(id(value))
            if found is None:
                inner = _Writer(sizes=False)
                inner.write((value,))
                found = self._types[id(value)] = bytes(inner.out)
            return found
        if sign == "^":
            return _plain(value if self._sizes else None)
        code = WORDS.get(value)
        return _string(value) if code is None else b"\10" + _number(code)
