"""How a program's shared variables lie on the wire: their indices, types, first values and greatest lengths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from koordgen.runtime.program import Variable
from koordgen.runtime.values import transmissible
from koordgen.runtime.wire import LIMIT, MAX_ROBOTS, Closing, Write, encoder, overhead

_CLOSING = 1 + 2 + 9 + 9 + 1 + 1 + 3  # array, author, first, round, stopped, commit, array of writes
_WRITE = 1 + 3  # array, index


class TooLarge(Exception):
    """What a robot may write in one round does not fit in one datagram."""


class Layout:
    """The shared variables of one program in a fleet of `n_sys`. Raises TooLarge."""

    def __init__(self, shared: Sequence[Variable], n_sys: int) -> None:
        self.n_sys = n_sys
        self.names = tuple(v.name for v in shared)
        self.is_slots = tuple(v.kind == "allread" for v in shared)
        self._shared = tuple(shared)
        self._index = {v.name: i for i, v in enumerate(shared)}
        self._decoders = tuple(msgspec.msgpack.Decoder(v.type) for v in shared)
        if n_sys > MAX_ROBOTS:
            raise TooLarge(f"a fleet of {n_sys} robots; at most {MAX_ROBOTS} are supported")
        needed = _CLOSING + sum(_WRITE + v.bound.bytes for v in shared)
        room = LIMIT - overhead(n_sys)
        if needed > room:
            raise TooLarge(
                f"one round's shared writes take up to {needed} bytes; with {n_sys} robots a datagram has room "
                f"for {room}"
            )

    def initial(self) -> dict[str, Any]:
        """The shared variables before any `init`; an allread variable as the tuple of its slots."""
        values = {v.name: v.initial() for v in self._shared}
        return {
            name: (value,) * self.n_sys if slots else value
            for (name, value), slots in zip(values.items(), self.is_slots, strict=True)
        }

    def writes(self, shared: Mapping[str, Any]) -> tuple[Write, ...]:
        """What an event wrote, as it goes over the wire."""
        indexed = sorted((self._index[name], value) for name, value in shared.items())
        return tuple(Write(i, msgspec.Raw(encoder.encode(value))) for i, value in indexed)

    def read(self, closing: Closing) -> list[tuple[int, Any]] | None:
        """The values a closing carries, by index; None when anything in it does not fit this program."""
        if closing.author >= self.n_sys or closing.first > closing.round:
            return None
        if not closing.writes:
            return []
        if closing.first != closing.round:
            return None
        values: list[tuple[int, Any]] = []
        before = -1
        for write in closing.writes:
            if not before < write.index < len(self._decoders):
                return None
            try:
                value = self._decoders[write.index].decode(write.value)
            except (msgspec.DecodeError, RecursionError):
                return None
            if not transmissible(value) or self._shared[write.index].bound.flaw(value):
                return None
            values.append((write.index, value))
            before = write.index
        return values
