"""Wire layout of a program's shared variables: indices, types, initial values and largest lengths."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec

from koordgen.runtime.net.codec import encoder, overhead
from koordgen.runtime.net.patch import difference, patched
from koordgen.runtime.net.wire import LIMIT, MAX_ROBOTS, MOST_FRAGMENTS, Entry, Write
from koordgen.runtime.program.program import Variable
from koordgen.runtime.values.bounds import Text
from koordgen.runtime.values.points import transmissible

MOST_ENTRY = 128 * 1024  # largest size of one robot's entry of one round, in bytes
MOST_SHARED = 256  # largest number of shared variables, and therefore of writes in an entry
PATCH_FROM = 256  # bytes; a shorter value is sent whole, because computing a patch costs more than it saves

# Bytes of an encoded entry without its writes: array, author, 3 numbers (incarnation, first, round), 3 bools, lock,
# array of writes.
_ENTRY = 1 + 1 + 3 * 9 + 3 + 3 + 3
_WRITE = 1 + 3 + 1  # bytes of an encoded write without its value: array, index, bool
_PLAIN = str, int, float, bool  # types whose values are equal after encoding and decoding
_parts = msgspec.msgpack.Decoder(list[msgspec.Raw])


class TooLarge(Exception):
    """Raised if a program's writes or store are too large to be sent, or for too many robots or variables."""


@dataclass(frozen=True, slots=True)
class Unpatched:
    """Value received as a patch to the value at the beginning of the round. `resolve` applies the patch."""

    patch: bytes


class Layout:
    """Shared variables of one program in a fleet of `n_sys` robots. Raises TooLarge."""

    def __init__(self, shared: Sequence[Variable], n_sys: int) -> None:
        self.n_sys = n_sys
        self.names = tuple(v.name for v in shared)
        self.is_slots = tuple(v.kind == "allread" for v in shared)
        self._shared = tuple(shared)
        self._decoders = tuple(msgspec.msgpack.Decoder(v.type) for v in shared)
        self._plain = tuple(v.type if v.type in _PLAIN else None for v in shared)
        self._fits = tuple([_fits(v) for v in shared])
        self._by_name = {v.name: i for i, v in enumerate(shared)}
        self._encoded: dict[int, tuple[Any, bytes]] = {}
        if n_sys > MAX_ROBOTS:
            raise TooLarge(f"a fleet of {n_sys} robots; at most {MAX_ROBOTS} are supported")
        if len(shared) > MOST_SHARED:
            raise TooLarge(f"a program with {len(shared)} shared variables; at most {MOST_SHARED} are supported")
        needed, most = self.entry_bytes, most_entry(n_sys)
        if needed > most:
            raise TooLarge(
                f"one round's shared writes take up to {needed} bytes; with {n_sys} robots at most {most} can be sent"
            )
        needed, most = self.snapshot_bytes, most_snapshot(n_sys)
        if needed > most:
            raise TooLarge(
                f"all shared variables together take up to {needed} bytes; with {n_sys} robots at most {most} can be "
                "sent to a robot that rejoins"
            )

    @property
    def entry_bytes(self) -> int:
        """Largest length of an encoded entry, in bytes."""
        return _ENTRY + sum(_WRITE + v.bound.bytes for v in self._shared)

    @property
    def snapshot_bytes(self) -> int:
        """Largest length of an encoded snapshot, in bytes."""
        n, array = self.n_sys, 1 if self.n_sys < 16 else 3
        view = 1 + 2 * 9 + array + 9 * n
        beside = 1 + view + 9 + (1 if len(self._shared) < 16 else 3) + (array + 9 * n) + (array + 5 * n)
        return beside + sum(array + n * v.bound.bytes if v.kind == "allread" else v.bound.bytes for v in self._shared)

    def initial(self) -> dict[str, Any]:
        """Return name -> initial value of each shared variable. An allread variable is the tuple of its slots."""
        values = {v.name: v.initial() for v in self._shared}
        return {
            name: (value,) * self.n_sys if slots else value
            for (name, value), slots in zip(values.items(), self.is_slots, strict=True)
        }

    def base(self, index: int, store: Mapping[str, Any], author: int) -> Any:
        """Return the value in `store` that an author's write replaces.

        For an allread variable this is the author's slot, else the value of the variable."""
        value = store[self.names[index]]
        return value[author] if self.is_slots[index] else value

    def pack(self, store: Mapping[str, Any]) -> tuple[msgspec.Raw, ...]:
        """Encode the whole store for a robot that rejoins."""
        return tuple([msgspec.Raw(encoder.encode(store[name])) for name in self.names])

    def unpack(self, values: Sequence[msgspec.Raw]) -> dict[str, Any] | None:
        """Decode a store that `pack` has encoded. Return None if the store does not fit this program."""
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
        """Return the encoded writes of an author's event, and their values as `read` returns them.

        shared: name -> value that the event wrote.
        store: shared variables at the beginning of the round. A large value that differs little from its value in
            `store` is encoded as a patch.
        A number or text of exactly the variable's type is equal after encoding and decoding, so it is not decoded. The
        second result is None if a value does not fit the program."""
        writes: list[Write] = []
        values: list[tuple[int, Any]] = []
        for index in sorted([self._by_name[name] for name in shared]):
            item = shared[self.names[index]]
            whole = encoder.encode(item)
            patch = None
            if len(whole) > PATCH_FROM and store is not None:
                patch = difference(self._encoding(index, self.base(index, store, author)), whole)
            if patch is not None:
                whole, item = patch, Unpatched(patch)
            elif type(item) is not self._plain[index]:
                item = self._value(index, whole)
            elif not self._fits[index](item):
                item = None
            writes.append(Write(index, msgspec.Raw(whole), patch is not None))
            values.append((index, item))
        return tuple(writes), None if any(item is None for _, item in values) else values

    def read(self, entry: Entry) -> Sequence[tuple[int, Any]] | None:
        """Return the values of an entry as pairs (index of the variable, value).

        For a patch, the value is an Unpatched object. Return None if the entry does not fit this program."""
        first, round_, writes = entry.first, entry.round, entry.writes
        if entry.author >= self.n_sys or first > round_:
            return None
        if first != round_ and (writes or entry.acted or entry.lock >= 0):
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
        """Return the value for `item`, a result of `read`: apply the patch if `item` is one.

        base: the variable's value at the beginning of the round.
        Return None for a patch that does not fit `base`. The result depends only on the arguments, so either all robots
        apply the write or none does."""
        if not isinstance(item, Unpatched):
            return item
        data = patched(self._encoding(index, base), item.patch, self._shared[index].bound.bytes)
        return None if data is None else self._value(index, data)

    def _value(self, index: int, data: bytes | msgspec.Raw) -> Any | None:
        """Decode a value of variable `index`; None if this program cannot write the value."""
        try:
            value = self._decoders[index].decode(data)
        except (ValueError, RecursionError):
            return None
        return value if self._fits[index](value) else None

    def _encoding(self, index: int, value: Any) -> bytes:
        """Return the encoding of a value. It is cached, because several robots may patch a value in one round."""
        known = self._encoded.get(index)
        if known is None or known[0] is not value:
            known = self._encoded[index] = value, encoder.encode(value)
        return known[1]


def _fits(variable: Variable) -> Callable[[Any], bool]:
    """Return a predicate: whether this program can write a given value to the variable."""
    bound = variable.bound

    def fits(value: Any) -> bool:
        return transmissible(value) and not bound.flaw(value)

    def text_fits(value: str) -> bool:
        return len(value) <= capacity if value.isascii() else fits(value)

    if variable.type is str and isinstance(bound, Text):  # texts are the longest values to check
        capacity = bound.capacity
        return text_fits
    return fits


def most_entry(n_sys: int) -> int:
    """Return the largest length of an entry in bytes, for a fleet of `n_sys` robots."""
    return min(MOST_ENTRY, most_snapshot(n_sys))


def most_snapshot(n_sys: int) -> int:
    """Return the largest length of an encoded snapshot in bytes: as much as MOST_FRAGMENTS fragments hold."""
    return MOST_FRAGMENTS * (LIMIT - overhead(n_sys))
