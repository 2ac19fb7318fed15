"""`--foxglove`: live stream of a run or a fleet to Foxglove, by Foxglove's own SDK.

The SDK serves the WebSocket on threads of its own and drops messages that a client does not read in time, so nothing
waits for a client. Messages of a topic without readers are not even encoded. But the newest state of the scene, maps,
shared variables and phases is kept, and sent again to all clients of a topic when a client joins."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import msgspec

from koordgen.runtime.trace.schema import Header, InitRecord, Round, TraceRecord
from targets.sim.view.data.feed import Feed
from targets.sim.view.data.rows import Chunk
from targets.sim.view.foxglove.messages import Message, Messages
from targets.sim.view.foxglove.schemas import schema

HOST = "127.0.0.1"
KEPT = ("/scene", "/maps/", "/shared/", "/phases")
PACKAGE = "foxglove-sdk"


class FoxgloveServer:
    """Server of topics at `url`.

    All methods but the constructor may be called from any thread, and none waits for a client. Raises
    ModuleNotFoundError without the package, OSError if the port is not available."""

    def __init__(self, header: Header, port: int, host: str = HOST) -> None:
        try:
            import foxglove
        except ModuleNotFoundError:
            raise ModuleNotFoundError(name=PACKAGE) from None
        self._foxglove: Any = foxglove
        self._context: Any = foxglove.Context()
        self._channels: dict[str, Any] = {}
        # topic -> entity or robot -> time and content
        self._kept: dict[str, dict[str, tuple[int, dict[str, Any]]]] = {}
        self._lock = threading.RLock()
        self._messages = Messages(header)
        try:
            self._server: Any = foxglove.start_server(
                name=f"koordgen: {header.app}", host=host, port=port, context=self._context,
                server_listener=_Latecomers(self._renew),
            )  # fmt: skip
        except RuntimeError as error:
            raise OSError(f"Foxglove cannot be served at port {port}: {error}; name another port") from None
        self.url = f"ws://{host}:{self._server.port}"
        self.put(0, self._messages.standing(0))

    def put(self, at: int, messages: Iterable[Message]) -> None:
        """Send messages with the time `at`, in nanoseconds."""
        for topic, kind, what in messages:
            with self._lock:
                channel = self._channels.get(topic) or self._channel(topic, kind)
                if topic.startswith(KEPT):
                    self._keep(topic, at, what)
                if channel.has_sinks():
                    channel.log(msgspec.json.encode(what), log_time=at)

    def rows(self, chunk: Chunk, nanoseconds: Callable[[float], int]) -> None:
        """Send rows (rows.py); `nanoseconds` converts t to the time of a message."""
        for at, message in self._messages.of_rows(chunk, nanoseconds):
            self.put(at, (message,))

    def renew(self, header: Header, at: int) -> None:
        """Continue with a more complete header from the time `at`, in nanoseconds."""
        self._messages = Messages(header)
        self.put(at, self._messages.standing(at))

    def _channel(self, topic: str, kind: str) -> Any:
        found = self._foxglove.Schema(name=kind, encoding="jsonschema", data=msgspec.json.encode(schema(kind)))
        channel = self._foxglove.Channel(topic, schema=found, message_encoding="json", context=self._context)
        self._channels[topic] = channel
        return channel

    def _keep(self, topic: str, at: int, what: dict[str, Any]) -> None:
        kept = self._kept.setdefault(topic, {})
        if topic == "/scene":
            kept.update((entity["id"], (at, entity)) for entity in what["entities"])
        else:
            kept[what.get("robot", "")] = at, what

    def _renew(self, topic: str) -> None:
        """Send the kept state of a topic that a client has joined."""
        with self._lock:
            kept = self._kept.get(topic, {})
            if topic == "/scene" and kept:
                latest = max(at for at, _ in kept.values())
                whole = {"deletions": [], "entities": [entity for _, entity in kept.values()]}
                self._channels[topic].log(msgspec.json.encode(whole), log_time=latest)
                return
            for at, what in kept.values():
                self._channels[topic].log(msgspec.json.encode(what), log_time=at)

    def close(self) -> None:
        """End the stream. Idempotent."""
        self._server.stop()


class _Latecomers:
    """Listener of the SDK's server. Only these callbacks occur, for clients may only read."""

    def __init__(self, joined: Callable[[str], None]) -> None:
        self._joined = joined

    def on_subscribe(self, client: Any, channel: Any) -> None:
        self._joined(channel.topic)

    def on_unsubscribe(self, client: Any, channel: Any) -> None:
        """Do nothing: the server keeps no data of clients."""


class Streamed(Feed):
    """Companion that streams a run. Times of messages count from the launch, so they never decrease."""

    def __init__(self, header: Header, server: FoxgloveServer) -> None:
        super().__init__(header)
        self._server = server
        self._messages = Messages(header)
        self._shift = 0.0  # s from the launch to round 1

    def _add(self, record: TraceRecord, t: float) -> None:
        if isinstance(record, Header) or (not self._begun and isinstance(record, (InitRecord, Round))):
            return  # records before the start of round 1 are passed on again later
        at = max(0, round((t + self._shift) * 1e9))
        self._server.put(at, self._messages.of(msgspec.structs.replace(record, t=round(t, 6)), at))

    def _reset(self) -> None:
        zero = self._run.zero
        self._shift = 0.0 if zero is None else zero - self._launched

    def _send(self) -> None:
        """Do nothing: each message is sent at once."""

    def flush(self) -> None:
        """Do nothing: each message is sent at once. See Feed."""


@contextmanager
def streamed(header: Header, port: int | None) -> Iterator[Streamed | None]:
    """Context manager of the stream during a run; yields None without a port.

    Prints its address to standard error. Raises as FoxgloveServer."""
    if port is None:
        yield None
        return
    server = FoxgloveServer(header, port)
    print(f"foxglove: {server.url}", file=sys.stderr, flush=True)
    try:
        yield Streamed(header, server)
    finally:
        server.close()
