"""How a program's shared variables lie on the wire: their indices, types, first values and greatest lengths."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import msgspec

from koordgen.runtime.net.patch import difference, patched
from koordgen.runtime.net.wire import LIMIT, MAX_ROBOTS, MOST_PIECES, Closing, Write, encoder, overhead
from koordgen.runtime.program.program import Variable
from koordgen.runtime.values.bounds import Text
from koordgen.runtime.values.points import transmissible

MOST_CLOSING = 128 * 1024  # bytes of one robot's closing of one round
MOST_SHARED = 256  # variables: so many writes a closing may have
PATCH_FROM = 256  # bytes: a shorter value goes whole; to find the difference would cost more than it saves on the air

_CLOSING = 1 + 1 + 3 * 9 + 3 + 3 + 3  # array, author, incarnation, first, round, three bools, lock, array of writes
_WRITE = 1 + 3 + 1  # array, index, bool
_PLAIN = str, int, float, bool  # types whose values any encoding gives back as they were
_parts = msgspec.msgpack.Decoder(list[msgspec.Raw])


class TooLarge(Exception):
    """What a robot may write in one round, or what all of them hold, is more than can be sent; or there are too many
    robots or variables."""


class Unpatched(msgspec.Struct, frozen=True):
    """A written value of which only the difference to the round's first value came: see `resolve`."""

    patch: bytes


class Layout:
    """The shared variables of one program in a fleet of `n_sys`. Raises TooLarge."""

    def __init__(self, shared: Sequence[Variable], n_sys: int) -> None:
        self.n_sys = n_sys
        self.names = tuple(v.name for v in shared)
        self.is_slots = tuple(v.kind == "allread" for v in shared)
        self._shared = tuple(shared)
        self._decoders = tuple(msgspec.msgpack.Decoder(v.type) for v in shared)
        self._plain = tuple(v.type if v.type in _PLAIN else None for v in shared)
        self._fits = tuple(map(_test, shared))
        self._by_name = {v.name: i for i, v in enumerate(shared)}
        self._encoded: dict[int, tuple[Any, bytes]] = {}
        if n_sys > MAX_ROBOTS:
            raise TooLarge(f"a fleet of {n_sys} robots; at most {MAX_ROBOTS} are supported")
        if len(shared) > MOST_SHARED:
            raise TooLarge(f"a program of {len(shared)} shared variables; at most {MOST_SHARED} are supported")
        needed, most = self.closing_bytes, most_closing(n_sys)
        if needed > most:
            raise TooLarge(
                f"one round's shared writes take up to {needed} bytes; with {n_sys} robots at most {most} can be sent"
            )
        needed, most = self.state_bytes, most_state(n_sys)
        if needed > most:
            raise TooLarge(
                f"all shared variables together take up to {needed} bytes; with {n_sys} robots at most {most} can be "
                "handed to a robot that comes back"
            )

    @property
    def closing_bytes(self) -> int:
        """The most bytes of an encoded closing."""
        return _CLOSING + sum(_WRITE + v.bound.bytes for v in self._shared)

    @property
    def state_bytes(self) -> int:
        """The most bytes of an encoded State."""
        n, array = self.n_sys, 1 if self.n_sys < 16 else 3
        view = 1 + 2 * 9 + array + 9 * n
        beside = 1 + view + 9 + (1 if len(self._shared) < 16 else 3) + (array + 9 * n) + (array + 5 * n)
        return beside + sum(array + n * v.bound.bytes if v.kind == "allread" else v.bound.bytes for v in self._shared)

    def initial(self) -> dict[str, Any]:
        """The shared variables before any `init`; an allread variable as the tuple of its slots."""
        values = {v.name: v.initial() for v in self._shared}
        return {
            name: (value,) * self.n_sys if slots else value
            for (name, value), slots in zip(values.items(), self.is_slots, strict=True)
        }

    def base(self, index: int, store: Mapping[str, Any], author: int) -> Any:
        """What an author's write takes the place of: the variable's value, of an allread one the author's slot."""
        value = store[self.names[index]]
        return value[author] if self.is_slots[index] else value

    def pack(self, store: Mapping[str, Any]) -> tuple[msgspec.Raw, ...]:
        """The whole store as it goes over the wire, for one who comes in."""
        return tuple([msgspec.Raw(encoder.encode(store[name])) for name in self.names])

    def unpack(self, values: Sequence[msgspec.Raw]) -> dict[str, Any] | None:
        """The store in what `pack` made; None when anything in it does not fit this program."""
        if len(values) != len(self.names):
            return None
        store: dict[str, Any] = {}
        for index, (name, slots, data) in enumerate(zip(self.names, self.is_slots, values, strict=True)):
            try:
                parts = _parts.decode(data) if slots else [data]
            except (ValueError, RecursionError):
                return None
            found = tuple([self._value(index, part) for part in parts])
            if len(found) != (self.n_sys if slots else 1) or None in found:
                return None
            store[name] = found if slots else found[0]
        return store

    def written(
        self, shared: Mapping[str, Any], store: Mapping[str, Any] | None = None, author: int = 0
    ) -> tuple[tuple[Write, ...], Sequence[tuple[int, Any]] | None]:
        """What an event of the author's wrote, as it goes over the wire, and what `read` would give of it. A large
        value that differs little from that in `store`, which its round began with, goes as a patch. A number or text of
        just the variable's type is what its encoding yields, so it is not decoded."""
        writes, values, fit = list[Write](), list[tuple[int, Any]](), True
        for index in sorted([self._by_name[name] for name in shared]):
            item = shared[self.names[index]]
            whole = encoder.encode(item)
            write = Write(index, msgspec.Raw(whole))
            if store is not None and len(whole) > PATCH_FROM:
                patch = difference(self._encoding(index, self.base(index, store, author)), whole)
                if patch is not None:
                    write = Write(index, msgspec.Raw(patch), True)
            if write.patch:
                item = Unpatched(bytes(write.value))
            elif type(item) is not self._plain[index]:
                item = self._value(index, whole)
            elif not self._fits[index](item):
                item = None
            fit = fit and item is not None
            writes.append(write)
            values.append((index, item))
        return tuple(writes), values if fit else None

    def read(self, closing: Closing) -> Sequence[tuple[int, Any]] | None:
        """What a closing carries, by index: values, and patches as Unpatched; None when anything in it does not fit
        this program."""
        first, round_, writes = closing.first, closing.round, closing.writes
        if closing.author >= self.n_sys or first > round_:
            return None
        if first != round_ and (writes or closing.acted or closing.lock >= 0):
            return None
        if not writes:
            return ()
        values: list[tuple[int, Any]] = []
        before, decoders = -1, self._decoders
        for write in writes:
            index = write.index
            if not before < index < len(decoders):
                return None
            if write.patch:
                values.append((index, Unpatched(bytes(write.value))))
            else:
                try:
                    value = decoders[index].decode(write.value)
                except (ValueError, RecursionError):
                    return None
                if not self._fits[index](value):
                    return None
                values.append((index, value))
            before = index
        return values

    def resolve(self, index: int, item: Any, base: Any) -> Any | None:
        """The value of what `read` gave, where the round began with `base` (see there); None for a patch that does not
        fit it. That depends on nothing else, so all robots take the write, or none does."""
        if not isinstance(item, Unpatched):
            return item
        data = patched(self._encoding(index, base), item.patch, self._shared[index].bound.bytes)
        return None if data is None else self._value(index, data)

    def _value(self, index: int, data: bytes | msgspec.Raw) -> Any | None:
        """The value in an encoding; None when it is none that this program can write."""
        try:
            value = self._decoders[index].decode(data)
        except (ValueError, RecursionError):
            return None
        return value if self._fits[index](value) else None

    def _encoding(self, index: int, value: Any) -> bytes:
        """The encoding of a value that several robots may patch in one round: kept until there is another."""
        known = self._encoded.get(index)
        if known is None or known[0] is not value:
            known = self._encoded[index] = value, encoder.encode(value)
        return known[1]


def _test(variable: Variable) -> Callable[[Any], bool]:
    """Return the predicate of those values of the variable's type that this program can write."""
    bound = variable.bound

    def fits(value: Any) -> bool:
        return transmissible(value) and not bound.flaw(value)

    def text_fits(value: str) -> bool:
        return len(value) <= capacity if value.isascii() else fits(value)

    if variable.type is str and isinstance(bound, Text):  # the kind of value that takes longest to go through
        capacity = bound.capacity
        return text_fits
    return fits


def most_closing(n_sys: int) -> int:
    """The most bytes that a closing may have in a fleet of that size: in many small pieces, less than in few."""
    return min(MOST_CLOSING, most_state(n_sys))


def most_state(n_sys: int) -> int:
    """The most bytes that an encoded State may have in a fleet of that size: as many as go in pieces."""
    return MOST_PIECES * (LIMIT - overhead(n_sys))
