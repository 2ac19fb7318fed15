"""Process of the live view.

Serves one page to this computer's browsers, and rows as server-sent events.

It reads JSON objects, one a line, on standard input: {"header"} first, then {"rows"}, {"begin"} (discard all before),
{"control": state} and {"over": words}. It ends with its input. Its first line of output is {"port"} or {"error"}. A
browser that reads too slowly misses rows and then receives all of them again.

If the first line has {"control": offer}, the page gets the controls of the run and a token. Each command sent with that
token (guard.py) is written to standard output as a line of JSON, as the page sent it. The run checks it."""

from __future__ import annotations

import json
import os
import queue
import select
import signal
import sys
import threading
import time
from collections.abc import Callable
from html import escape
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Protocol

import msgspec

from koordgen.runtime.trace.schema import Header
from targets.sim.view.data.history import History
from targets.sim.view.web.guard import ControlGuard
from targets.sim.view.web.page import page

HOST = "127.0.0.1"
MOST_CLIENTS = 16
MOST_WAITING = 64  # events queued per client
SEND_TIMEOUT = 10.0  # seconds that a write to a client may take
KEEP_ALIVE = 5.0  # seconds of silence after which a keep-alive is sent
FAREWELL = 2.0  # seconds for sending the last events
_encoder = msgspec.json.Encoder()


def event(name: str, what: Any) -> bytes:
    """Return a server-sent event. JSON has no line ends, so it is one line."""
    return b"event: %b\ndata: %b\n\n" % (name.encode(), _encoder.encode(what))


class RowStore(Protocol):
    """Collector of the rows that a new client receives."""

    def extend(self, chunk: dict[str, Any]) -> None: ...

    def whole(self) -> dict[str, Any]: ...


class EventHub:
    """Distributor of events to all clients.

    Its methods may be called from any thread; none waits for a client."""

    def __init__(self, header: Header, keep: Callable[[Header], RowStore] = History) -> None:
        self.header = header
        self._keep = keep
        self._history = keep(header)
        self._control: dict[str, Any] | None = None  # state of the run's controls
        self._clients: set[queue.Queue[bytes]] = set()
        self._lock = threading.Lock()
        self.over = threading.Event()

    def rows(self, chunk: dict[str, Any]) -> None:
        with self._lock:
            self._history.extend(chunk)
            self._broadcast(event("rows", chunk))

    def begin(self) -> None:
        """Discard all rows: round 1 begins now."""
        with self._lock:
            self._history = self._keep(self.header)
            self._broadcast(event("whole", self._history.whole()))

    def control(self, state: dict[str, Any]) -> None:
        """Send the state of the run's controls; `message` is the result of a command."""
        with self._lock:
            self._control = {**state, "message": ""}
            self._broadcast(event("control", state))

    def renew(self, header: Header) -> None:
        """Start again with another header. An open page shows the old one until it is reloaded."""
        with self._lock:
            self.header = header
            self._history = self._keep(header)

    def send(self, name: str, what: Any) -> None:
        """Send an event that later clients do not receive."""
        with self._lock:
            self._broadcast(event(name, what))

    def end(self, words: str) -> None:
        self.send("over", {"words": words})
        deadline = time.monotonic() + FAREWELL
        while any(not client.empty() for client in self._clients) and time.monotonic() < deadline:
            time.sleep(0.05)
        self.over.set()

    def _broadcast(self, words: bytes) -> None:
        for client in self._clients:
            try:
                client.put_nowait(words)
            except queue.Full:  # too slow: one event with all rows replaces those that it missed
                while not client.empty():
                    client.get_nowait()
                self._begin(client)

    def join(self) -> queue.Queue[bytes] | None:
        """Return the event queue of a new client, starting with all rows; None if there are too many clients."""
        with self._lock:
            if len(self._clients) >= MOST_CLIENTS:
                return None
            client: queue.Queue[bytes] = queue.Queue(MOST_WAITING)
            self._begin(client)
            self._clients.add(client)
            return client

    def _begin(self, client: queue.Queue[bytes]) -> None:
        client.put_nowait(event("whole", self._history.whole()))
        if self._control is not None:
            client.put_nowait(event("control", self._control))

    def leave(self, client: queue.Queue[bytes]) -> None:
        with self._lock:
            self._clients.discard(client)


def pass_on(command: dict[str, Any]) -> bool:
    """Write a command to the run. Return False if the run has not read earlier ones.

    A line up to PIPE_BUF is written completely or not at all."""
    line = json.dumps(command).encode() + b"\n"
    try:
        return len(line) <= select.PIPE_BUF and os.write(sys.stdout.fileno(), line) == len(line)
    except OSError:
        return False


class Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False

    def __init__(
        self, port: int, hub: EventHub, offer: dict[str, Any] | None = None,
        obey: Callable[[dict[str, Any]], bool] = pass_on, host: str = HOST, handler: type[Handler] | None = None,
    ) -> None:  # fmt: skip
        """Create the server.

        `offer`: what the page's controls offer; None for no controls and no commands. `obey` receives each command, in
        any thread, and returns whether it was accepted."""
        super().__init__((host, port), handler or Handler)
        self.hub, self.obey, self._offer = hub, obey, offer
        own = self.server_address[1]
        # Another host name for this address belongs to another site, which must not read the page (DNS rebinding).
        self.names = {f"{name}:{own}" for name in (HOST, "localhost")}
        self.guard = None if offer is None else ControlGuard(self.names)

    @property
    def page(self) -> bytes:
        """The page of the present fleet."""
        control = None if self._offer is None or self.guard is None else {**self._offer, "token": self.guard.token}
        title = f"{self.hub.header.app}, live"
        before = f"<h1>{escape(title)}</h1>"
        return page(title, self.hub.header, {}, before, "", live=True, control=control).encode()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore errors of connections: clients come and go."""


class Handler(BaseHTTPRequestHandler):
    server: Server
    timeout = SEND_TIMEOUT
    server_version, sys_version = "koordgen", ""

    def do_GET(self) -> None:
        if not self.admitted():
            return
        if self.path == "/":
            self.give("text/html; charset=utf-8", self.server.page)
        elif self.path == "/events":
            self._events()
        else:
            self.send_error(404)

    def admitted(self) -> bool:
        """Return whether the request may be answered; otherwise refuse it."""
        if self.headers.get_all("Host") in [[name] for name in self.server.names]:
            return True
        self.send_error(403, "This page is for the computer it runs on")
        return False

    def give(self, kind: str, body: bytes) -> None:
        """Send a complete document."""
        self._answer(kind, str(len(body)))
        self.wfile.write(body)

    def do_POST(self) -> None:
        """Pass a command on to the run."""
        command = self.ordered()
        if command is None:
            return
        if not self.server.obey(command):
            self.send_error(503, "The run has not executed earlier commands yet")
        else:
            self.send_response(204)
            self.end_headers()

    def ordered(self) -> dict[str, Any] | None:
        """Return the command that the page sent; None after refusing the request.

        The body of a request that the guard refuses is not read."""
        guard = self.server.guard
        if guard is None:
            self.send_error(404, "This page has no controls")
            return None
        refused = guard.refusal(self.path, self.headers)
        command = None if refused else guard.command(self.rfile.read(guard.length(self.headers)))
        if refused or command is None:
            self.send_error(*(refused or (400, "A command is a JSON object")))
        return command

    def _answer(self, kind: str, length: str | None = None) -> None:
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        # so that no other site can embed this page
        self.send_header("Content-Security-Policy", "frame-ancestors 'none'")
        if length is not None:
            self.send_header("Content-Length", length)
        self.end_headers()

    def _events(self) -> None:
        client = self.server.hub.join()
        if client is None:
            self.send_error(503, "Too many pages watch already")
            return
        try:
            self._answer("text/event-stream")
            while not self.server.hub.over.is_set():
                try:
                    self.wfile.write(client.get(timeout=KEEP_ALIVE))
                except queue.Empty:
                    self.wfile.write(b": here\n\n")
        except OSError:  # the client is gone, or does not read
            pass
        finally:
            self.server.hub.leave(client)

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing."""


def main() -> int:
    """Serve until standard input ends. The only argument is the port, 0 for any."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the run decides when this process ends
    lines = sys.stdin.buffer
    first = json.loads(lines.readline())
    hub = EventHub(msgspec.convert(first["header"], Header))
    try:
        server = Server(int(sys.argv[1]), hub, first.get("control"))
    except OSError as error:
        print(json.dumps({"error": error.strerror or str(error)}), flush=True)
        return 1
    print(json.dumps({"port": server.server_address[1]}), flush=True)
    os.set_blocking(sys.stdout.fileno(), False)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    for line in lines:
        match json.loads(line):
            case {"rows": rows}:
                hub.rows(rows)
            case {"begin": _}:
                hub.begin()
            case {"control": state}:
                hub.control(state)
            case {"over": words}:
                hub.end(str(words))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
