"""Export of a trace as MCAP with JSON messages for Foxglove.

It has poses, transforms, a scene, logs, maps, and the program's rounds, shared variables, verdicts and metrics. Times
count from the trace's first record, because MCAP has no negative times. The file's metadata record `koord` has the
start of round 1; koord.* messages have `t` since then. The same trace gives the same bytes."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import msgspec
from mcap.writer import Writer

from koordgen.runtime.trace.schema import Header, TraceRecord
from targets.sim.view.foxglove.messages import Message, Messages
from targets.sim.view.foxglove.schemas import schema


def write(path: Path, header: Header, records: Iterable[TraceRecord]) -> None:
    """Write the file, reading the records once. Raises BadTrace, OSError."""
    with path.open("wb") as file:
        writer: Any = Writer(file)
        writer.start("", "koordgen")
        out = _Channels(writer)
        messages = Messages(header)
        begun = False
        for record in records:
            if isinstance(record, Header):
                continue
            if not begun:
                begun = True
                out.zero = math.floor(min(0.0, record.t))
                facts = {"app": header.app, "program_hash": header.program_hash, "seed": str(header.seed)}
                writer.add_metadata("koord", {**facts, "delta": str(header.delta), "round_1_at": str(-out.zero)})
                out.put(record.t, messages.standing(out.nanoseconds(record.t)))
            out.put(record.t, messages.of(record, out.nanoseconds(record.t)))
        writer.finish()


class _Channels:
    """Writer of messages: a channel for each topic, each schema once.

    `zero` is the t of time 0 in the file."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._counts: dict[str, int] = {}
        self._encoder = msgspec.json.Encoder()
        self.zero = 0

    def nanoseconds(self, t: float) -> int:
        return max(0, round((t - self.zero) * 1e9))

    def put(self, t: float, messages: Iterable[Message]) -> None:
        at = self.nanoseconds(t)
        for topic, kind, what in messages:
            if kind not in self._schemas:
                data = self._encoder.encode(schema(kind))
                self._schemas[kind] = self._writer.register_schema(kind, "jsonschema", data)
            if topic not in self._channels:
                self._channels[topic] = self._writer.register_channel(topic, "json", self._schemas[kind])
            self._counts[topic] = self._counts.get(topic, 0) + 1
            data = self._encoder.encode(what)
            self._writer.add_message(self._channels[topic], at, data, at, self._counts[topic])
