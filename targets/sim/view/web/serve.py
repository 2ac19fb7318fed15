"""The live view's own process: one page for this computer's browsers, and rows as server-sent events.

It is told on standard input, a JSON object a line: {"header"} first, then {"rows"}, {"begin"} (all before does not
count), {"control": state} and {"over": words}; it ends when its input does. The first line it says is {"port"} or
{"error"}. A browser that reads slowly misses rows and is then given all of them anew.

When the first line has {"control": offer}, the page gets the controls of the run and a token. Each command that is sent
with that token (guard.py) is a further line on standard output, a JSON object as the page made it: the run judges it.
"""

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
from targets.sim.view.web.guard import Guard
from targets.sim.view.web.page import page

HOST = "127.0.0.1"
MOST_CLIENTS = 16
MOST_WAITING = 64  # events of one client
SEND_TIMEOUT = 10.0  # seconds that a write to a client may take
KEEP_ALIVE = 5.0  # seconds of silence after which a client is told that we are there
FAREWELL = 2.0  # seconds for the last events to get out
_encoder = msgspec.json.Encoder()


def event(name: str, what: Any) -> bytes:
    """A server-sent event. JSON has no line ends, so it is one line."""
    return b"event: %b\ndata: %b\n\n" % (name.encode(), _encoder.encode(what))


class Rows(Protocol):
    """Keeps the rows of which a new client gets all."""

    def extend(self, chunk: dict[str, Any]) -> None: ...

    def whole(self) -> dict[str, Any]: ...


class Hub:
    """What clients are told. All its methods may be called from any thread; none waits for a client."""

    def __init__(self, header: Header, keep: Callable[[Header], Rows] = History) -> None:
        self.header = header
        self._keep = keep
        self._history = keep(header)
        self._control: dict[str, Any] | None = None  # the state of the run's controls
        self._clients: set[queue.Queue[bytes]] = set()
        self._lock = threading.Lock()
        self.over = threading.Event()

    def rows(self, chunk: dict[str, Any]) -> None:
        with self._lock:
            self._history.extend(chunk)
            self._tell(event("rows", chunk))

    def begin(self) -> None:
        """Everything so far was before the run's clock began."""
        with self._lock:
            self._history = self._keep(self.header)
            self._tell(event("whole", self._history.whole()))

    def control(self, state: dict[str, Any]) -> None:
        """The state of the run's controls, and with `message` what became of a command."""
        with self._lock:
            self._control = {**state, "message": ""}
            self._tell(event("control", state))

    def renew(self, header: Header) -> None:
        """Begin anew with another header. A page that is open shows the old one until it is loaded anew."""
        with self._lock:
            self.header = header
            self._history = self._keep(header)

    def send(self, name: str, what: Any) -> None:
        """Send an event that is not kept for clients who come later."""
        with self._lock:
            self._tell(event(name, what))

    def end(self, words: str) -> None:
        self.send("over", {"words": words})
        deadline = time.monotonic() + FAREWELL
        while any(not client.empty() for client in self._clients) and time.monotonic() < deadline:
            time.sleep(0.05)
        self.over.set()

    def _tell(self, words: bytes) -> None:
        for client in self._clients:
            try:
                client.put_nowait(words)
            except queue.Full:  # too slow: what is whole makes up for all that it has missed
                while not client.empty():
                    client.get_nowait()
                self._begin(client)

    def join(self) -> queue.Queue[bytes] | None:
        """A new client's events, the first has all rows; None when there are too many clients."""
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
    """Write a command for the run; False when the run has not read the earlier ones. A line up to PIPE_BUF is written
    whole or not at all."""
    line = json.dumps(command).encode() + b"\n"
    try:
        return len(line) <= select.PIPE_BUF and os.write(sys.stdout.fileno(), line) == len(line)
    except OSError:
        return False


class Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False

    def __init__(
        self, port: int, hub: Hub, offer: dict[str, Any] | None = None,
        obey: Callable[[dict[str, Any]], bool] = pass_on, host: str = HOST, handler: type[Handler] | None = None,
    ) -> None:  # fmt: skip
        """`offer`: what the page's controls offer; None: the page has no controls, and no command is accepted. `obey`
        gets each command, in any thread, and returns whether it took it."""
        super().__init__((host, port), handler or Handler)
        self.hub, self.obey, self._offer = hub, obey, offer
        own = self.server_address[1]
        # Another name that leads here is another site's: it may not read what we say (DNS rebinding).
        self.names = {f"{name}:{own}" for name in (HOST, "localhost")}
        self.guard = None if offer is None else Guard(self.names)

    @property
    def page(self) -> bytes:
        """The page, of the fleet as it is now."""
        control = None if self._offer is None or self.guard is None else {**self._offer, "token": self.guard.token}
        title = f"{self.hub.header.app}, live"
        before = f"<h1>{escape(title)}</h1>"
        return page(title, self.hub.header, {}, before, "", live=True, control=control).encode()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Clients come and go."""


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
        """Return whether the request may be answered; if not, it has been refused."""
        if self.headers.get_all("Host") in [[name] for name in self.server.names]:
            return True
        self.send_error(403, "This page is for the computer it runs on")
        return False

    def give(self, kind: str, body: bytes) -> None:
        """Answer with a whole document."""
        self._answer(kind, str(len(body)))
        self.wfile.write(body)

    def do_POST(self) -> None:
        """A command to the run."""
        command = self.ordered()
        if command is None:
            return
        if not self.server.obey(command):
            self.send_error(503, "The run has not obeyed earlier commands yet")
        else:
            self.send_response(204)
            self.end_headers()

    def ordered(self) -> dict[str, Any] | None:
        """Return the command that the page sent; None: the request has been refused. Nothing is read of a request that
        the guard refuses."""
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
        self.send_header("Content-Security-Policy", "frame-ancestors 'none'")  # no other site's page can hold this one
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
        except OSError:  # it has gone, or takes nothing
            pass
        finally:
            self.server.hub.leave(client)

    def log_message(self, format: str, *args: Any) -> None:
        """Nobody reads it."""


def main() -> int:
    """Serve until standard input ends; the only argument is the port, 0 for any."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the run's end is ours
    lines = sys.stdin.buffer
    first = json.loads(lines.readline())
    hub = Hub(msgspec.convert(first["header"], Header))
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
