"""Wire layout of a fleet's shared variables: indices, types, initial values and largest lengths.

It says as well which instance may write which variable, so that an entry with other writes is refused."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec

from koordgen.runtime.net.codec import encoder, overhead
from koordgen.runtime.net.patch import difference, patched
from koordgen.runtime.net.wire import (
    LIMIT,
    MAX_INSTANCES,
    MAX_ROBOTS,
    MOST_FRAGMENTS,
    MOST_WRITES,
    Contribution,
    Entry,
    EntryPart,
    Write,
)
from koordgen.runtime.program.fleet_program import FleetProgram, StoreAccess, alone
from koordgen.runtime.program.program import Variable
from koordgen.runtime.values.bounds import Text
from koordgen.runtime.values.points import transmissible

MOST_ENTRY = 128 * 1024  # largest size of one robot's entry of one round, in bytes
MOST_SHARED = MOST_WRITES  # largest number of shared variables
PATCH_FROM = 256  # bytes; a shorter value is sent whole, because computing a patch costs more than it saves

# Bytes of an encoded entry without its writes: array, author, 3 numbers (incarnation, first, round), 3 bools, lock,
# array of writes.
_ENTRY = 1 + 1 + 3 * 9 + 3 + 3 + 3
_PARTS = 3  # bytes of the map of an entry's parts, without the parts
_PART = 3 + 1 + 2 + 3 + 3  # bytes of an encoded part without its writes: key, array, 2 bools, lock, array of writes
_WRITE = 1 + 3 + 1  # bytes of an encoded write without its value: array, index, bool
_PLAIN = str, int, float, bool  # types whose values are equal after encoding and decoding
_parts = msgspec.msgpack.Decoder(list[msgspec.Raw])


class TooLarge(Exception):
    """Raised if a program's writes or store are too large to be sent, or for too many robots or variables."""


@dataclass(frozen=True, slots=True)
class Unpatched:
    """Value received as a patch to the value at the beginning of the round. `resolve` applies the patch."""

    patch: bytes


class Author:
    """An instance as an author of writes.

    number, application, pid: see RobotInstance.
    indices: name in its program -> index of the variable, of those that the instance may write.
    allowed: these indices; None: all.
    locks: locks that its events may want; None: any.
    """

    __slots__ = ("allowed", "application", "indices", "locks", "number", "pid")

    def __init__(self, number: int, application: int, pid: int, access: StoreAccess, variables: int) -> None:
        self.number, self.application, self.pid = number, application, pid
        self.indices = access.indices
        self.locks = access.locks
        allowed = frozenset(access.indices.values())
        self.allowed = None if len(allowed) == variables else allowed

    def may_want(self, lock: int) -> bool:
        """Return whether an event of the instance may have this lock, or none (-1)."""
        return lock < 0 or self.locks is None or lock in self.locks


class Layout:
    """Shared variables of a fleet of `n_sys` robots. Raises TooLarge.

    access: for each application, what it may write; empty: one application on all robots declares all variables.
    authors: for each robot, its instances by their numbers.
    instances: number of all instances.
    """

    def __init__(self, shared: Sequence[Variable], n_sys: int, access: Sequence[StoreAccess] = ()) -> None:
        self.n_sys = n_sys
        self.names = tuple(v.name for v in shared)
        self.is_slots = tuple(v.kind == "allread" for v in shared)
        self._shared = tuple(shared)
        self._decoders = tuple(msgspec.msgpack.Decoder(v.type) for v in shared)
        self._plain = tuple(v.type if v.type in _PLAIN else None for v in shared)
        self._fits = tuple([_fits(v) for v in shared])
        self._encoded: dict[int, tuple[Any, bytes]] = {}
        access = access or alone(shared, n_sys)
        self.is_composed = len(access) > 1
        self.authors, self.instances = _authors(access, n_sys, len(shared))
        self._slots = tuple([len(a.members) for a in access for _ in range(a.owned)])  # of each variable, if allread
        self._check_sizes()

    @classmethod
    def of(cls, fleet: FleetProgram) -> Layout:
        """Return the layout of all applications of a fleet."""
        return cls(fleet.shared(), fleet.robots, fleet.access())

    def _check_sizes(self) -> None:
        n_sys, shared = self.n_sys, self._shared
        if n_sys > MAX_ROBOTS:
            raise TooLarge(f"a fleet of {n_sys} robots; at most {MAX_ROBOTS} are supported")
        if self.instances > MAX_INSTANCES:
            raise TooLarge(
                f"the applications run {self.instances} times on all robots together; at most {MAX_INSTANCES} are "
                "supported"
            )
        if len(shared) > MOST_SHARED:
            what = "applications" if self.is_composed else "a program"
            raise TooLarge(f"{what} with {len(shared)} shared variables; at most {MOST_SHARED} are supported")
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
        """Largest length of an encoded entry of any robot, in bytes."""
        return _ENTRY + max([self._contributed(authors) for authors in self.authors], default=0)

    def _contributed(self, authors: Sequence[Author]) -> int:
        """Return the largest length of the writes of a robot's instances, in bytes."""
        parts = _PARTS + _PART * len(authors) if len(authors) > 1 else 0
        return parts + sum([_WRITE + self._shared[i].bound.bytes for a in authors for i in a.indices.values()])

    @property
    def snapshot_bytes(self) -> int:
        """Largest length of an encoded snapshot, in bytes."""
        n = self.n_sys
        view = 1 + 2 * 9 + _array(n) + 9 * n
        instances = 2 * _array(self.instances) + (9 + 5) * self.instances
        beside = 1 + view + 9 + _array(len(self._shared)) + instances
        return beside + sum(
            _array(slots) + slots * v.bound.bytes if v.kind == "allread" else v.bound.bytes
            for v, slots in zip(self._shared, self._slots, strict=True)
        )

    def initial(self) -> dict[str, Any]:
        """Return name -> initial value of each shared variable. An allread variable is the tuple of its slots."""
        values = {v.name: v.initial() for v in self._shared}
        return {
            name: (value,) * count if slots else value
            for (name, value), slots, count in zip(values.items(), self.is_slots, self._slots, strict=True)
        }

    def base(self, index: int, store: Mapping[str, Any], slot: int) -> Any:
        """Return the value in `store` that an author's write replaces.

        For an allread variable this is the author's slot, else the value of the variable."""
        value = store[self.names[index]]
        return value[slot] if self.is_slots[index] else value

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
            if len(found) != (self._slots[index] if slots else 1) or None in found:
                return None
            store[name] = found if slots else found[0]
        return store

    def written(
        self, shared: Mapping[str, Any], store: Mapping[str, Any] | None = None, robot: int = 0, place: int = 0
    ) -> tuple[tuple[Write, ...], Sequence[tuple[int, Any]] | None]:
        """Return the encoded writes of an event, and their values as `read` returns them.

        shared: name in the program -> value that the event wrote.
        robot, place: the instance that ran the event: number `place` of those of the robot.
        store: shared variables at the beginning of the round. A large value that differs little from its value in
            `store` is encoded as a patch.
        A number or text of exactly the variable's type is equal after encoding and decoding, so it is not decoded. The
        second result is None if a value does not fit the program."""
        author = self.authors[robot][place]
        writes: list[Write] = []
        values: list[tuple[int, Any]] = []
        for index, item in sorted([(author.indices[name], item) for name, item in shared.items()], key=_first):
            whole = encoder.encode(item)
            patch = None
            if len(whole) > PATCH_FROM and store is not None:
                patch = difference(self._encoding(index, self.base(index, store, author.pid)), whole)
            if patch is not None:
                whole, item = patch, Unpatched(patch)
            elif type(item) is not self._plain[index]:
                item = self._value(index, whole)
            elif not self._fits[index](item):
                item = None
            writes.append(Write(index, msgspec.Raw(whole), patch is not None))
            values.append((index, item))
        return tuple(writes), None if any(item is None for _, item in values) else values

    def read(self, entry: Entry) -> Sequence[Contribution] | None:
        """Return the events in an entry, by instance.

        Return None if the entry does not fit this fleet: its author must run the instances, and each instance must be
        allowed to write the variables and to want the lock."""
        first, round_, writes, lock = entry.first, entry.round, entry.writes, entry.lock
        if entry.author >= self.n_sys or first > round_:
            return None
        if not (writes or entry.acted or lock >= 0):  # silent
            return ()
        if first != round_:
            return None
        authors = self.authors[entry.author]
        if isinstance(writes, dict):
            return self._read_parts(entry, authors, writes)
        if len(authors) != 1:
            return None
        author = authors[0]
        values = self._read(author, writes) if writes else ()
        if values is None or (lock >= 0 and not author.may_want(lock)):
            return None
        return (Contribution(author.number, author.pid, lock, entry.acted, False, values),)

    def _read_parts(
        self, entry: Entry, authors: Sequence[Author], parts: Mapping[int, EntryPart]
    ) -> Sequence[Contribution] | None:
        """Return the events of an entry whose author runs several instances. Parameters and result: see `read`."""
        found: list[Contribution] = []
        acted = False
        if len(authors) < 2 or entry.lock >= 0:
            return None
        for author in authors:
            part = parts.get(author.application)
            if part is None:
                continue
            writes, lock = part.writes, part.lock
            values = self._read(author, writes) if writes else ()
            if values is None or not author.may_want(lock):
                return None
            acted = acted or part.acted
            found.append(Contribution(author.number, author.pid, lock, part.acted, part.stopped, values))
        return found if len(found) == len(parts) and acted == entry.acted else None

    def _read(self, author: Author, writes: Sequence[Write]) -> Sequence[tuple[int, Any]] | None:
        """Return the values of an instance's writes; None if the instance cannot have written them."""
        values: list[tuple[int, Any]] = []
        before, decoders, allowed = -1, self._decoders, author.allowed
        for write in writes:
            index = write.index
            if not before < index < len(decoders) or (allowed is not None and index not in allowed):
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


def _authors(access: Sequence[StoreAccess], robots: int, variables: int) -> tuple[Sequence[Sequence[Author]], int]:
    """Return the instances of each robot by their numbers, and the number of all instances."""
    found: list[list[Author]] = [[] for _ in range(robots)]
    number = 0
    for application, these in enumerate(access):
        for pid, robot in enumerate(these.members):
            found[robot].append(Author(number, application, pid, these, variables))
            number += 1
    return found, number


def _array(length: int) -> int:
    """Return the most bytes of the head of an encoded array."""
    return 1 if length < 16 else 3


def _first(pair: tuple[int, Any]) -> int:
    return pair[0]


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
