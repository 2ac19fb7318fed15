"""Server of the dashboard.

The live view's page with a table of the robots, fed by reports of real agents.

It changes nothing, except for the emergency stop `stop`, if one was given. Another site can neither read the page (see
Server) nor send that command (see ControlGuard). With a token, a browser sends it once and then has a cookie."""

from __future__ import annotations

import hmac
import json
import secrets
import socket
import socketserver
import ssl
import threading
import time
from collections.abc import Callable, Collection, Mapping
from html import escape
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs

import msgspec

from koordgen.runtime.trace.schema import FORMAT, Header, RobotName
from targets.sim.view.foxglove.stream import FoxgloveServer
from targets.sim.view.web.fleet_rows import FRESH, FleetRows, LatestRows, Report, completed, read_report
from targets.sim.view.web.guard import ControlGuard
from targets.sim.view.web.page import page
from targets.sim.view.web.serve import EventHub, Handler, Server

TICK = 0.2  # seconds between two events for the pages
MOST_BROWSERS = 64  # browsers that hold a cookie
LONGEST_BODY = 1024  # bytes
COOKIE = "koordgen-dashboard"
Stop = Callable[[], list[dict[str, Any]]]

HEAD = """<header id="head"><h1>{title}</h1><p id="summary">no report yet</p>{stop}</header>
<section id="fleet"><h2>Robots</h2><div class="wide"><table><thead><tr><th>robot</th><th>phase</th>
<th class="n" title="seconds since the robot's last report">age (s)</th><th>note</th><th class="n">battery</th>
<th title="the release's first digits">runs</th><th>monitors</th><th>position (m), heading</th><th class="n">round</th>
<th class="n" title="rounds in which the shared state was there in time">current</th>
<th class="n" title="of datagrams, on the worst link">loss</th>
<th class="n" title="99 % of all rounds are decided so soon after their tick">late (ms)</th>
<th class="n" title="how far its clock may be off the fleet's">clock (ms)</th><th class="n">disk (GB)</th>
<th class="n">temp (°C)</th></tr></thead><tbody id="robots"></tbody></table></div></section>
<section id="parts" hidden><h2>Applications</h2><div class="wide"><table><thead><tr><th>robot</th><th>application</th>
<th class="n" title="the robot's place among those that run it">pid</th><th class="n">round</th><th>last event</th>
<th class="n">faults</th><th>state</th></tr></thead><tbody id="applications"></tbody></table></div></section>
<section id="said"><h2>Log</h2><div class="wide scroll"><table><thead><tr><th class="n">time</th><th>robot</th>
<th>level</th><th>line</th></tr></thead><tbody id="lines"></tbody></table></div></section>"""
STOP = """<aside id="emergency"><div id="stopped" role="alert"></div>
<button id="stop" aria-describedby="stopped">Hold 1 s to STOP all robots</button></aside>"""
LOGIN = """<!doctype html><html lang="en"><head><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1"><title>dashboard</title></head>
<body style="font: 18px sans-serif; max-width: 30rem; margin: 3rem auto; padding: 0 1rem">
<h1>Dashboard</h1><p>{words}</p><form method="post" action="/login">
<p><label>Token <input name="token" type="password" autocomplete="off" required
style="font: inherit; width: 100%"></label></p>
<button style="font: inherit; padding: .6rem 1.4rem">Open</button></form></body></html>"""
LOGIN_POLICY = "default-src 'none'; style-src 'unsafe-inline'; form-action 'self'; frame-ancestors 'none'"


def first_header(robots: list[tuple[str, str]], facts: Mapping[str, Any]) -> Header:
    """Return the header of a fleet from its robots' names and targets by pid, and from `facts`.

    `facts`: plain values of delta, geofence, obstacles and world, as far as known."""
    names = tuple(RobotName(name, pid, target) for pid, (name, target) in enumerate(robots))
    bare = Header(FORMAT, "", "", 0.0, 0, names)
    try:
        return msgspec.convert({**msgspec.to_builtins(bare), **facts}, Header)
    except msgspec.ValidationError:  # a folder of another release: show a map without obstacles
        return bare


class Dashboard:
    """Distributor of reports to the pages.

    `odd` returns the names of robots whose release differs from that of most. `stream`: Foxglove server that receives
    the same rows; closed with the dashboard."""

    def __init__(
        self, header: Header, odd: Callable[[], Collection[str]], stream: FoxgloveServer | None = None
    ) -> None:
        self.hub = EventHub(header, LatestRows)
        self._stream = stream
        self._rows = FleetRows(header)
        self._odd = odd
        self._lock = threading.Lock()
        self._zero, self._wall = time.monotonic(), time.time()
        self._made = secrets.token_urlsafe(8)
        self._renewed = 0
        self._over = threading.Event()

    def on_answer(self, pid: int, plain: Mapping[str, Any] | None, note: str) -> None:
        """Add the answer of robot `pid`: its report, or None with a note why there is none.

        May be called from any thread. An internal error is shown in the robot's row, without effect on other robots."""
        t = time.monotonic() - self._zero
        report = None if plain is None else read_report(plain)
        with self._lock:
            if report is None or isinstance(report, str):
                self._rows.miss(pid, report or note, t)
                return
            try:
                self._add_report(pid, report, note, t)
            except Exception as error:
                self._rows.miss(pid, f"internal error of the dashboard: {type(error).__name__}: {error}", t)

    def _add_report(self, pid: int, report: Report, note: str, t: float) -> None:
        header = completed(self._rows.header, report)
        if header is not self._rows.header:
            self._rows.renew(header)
            self.hub.renew(header)
            if self._stream is not None:
                self._stream.renew(header, self._nanoseconds(t))
            self._renewed += 1
        self._rows.add_report(pid, report, note, t)

    @property
    def version(self) -> str:
        """Version of the page; it changes when pages must be reloaded: a new header, or a restarted dashboard."""
        return f"{self._made}-{self._renewed}"

    def tick(self) -> None:
        """Send all new records to the pages."""
        t = time.monotonic() - self._zero
        with self._lock:
            chunk, robots = self._rows.taken(t), self._rows.table()
            if chunk:
                self.hub.rows(chunk)
                if self._stream is not None:
                    self._stream.rows(chunk, self._nanoseconds)
        odd = self._odd()
        for robot, name in zip(robots, self._rows.header.robots, strict=True):
            robot["odd"] = name.name in odd
        self.hub.send("fleet", {"t": t, "wall": time.time(), "fresh": FRESH, "version": self.version, "robots": robots})

    def _nanoseconds(self, t: float) -> int:
        """Return the time since 1970 at which the dashboard had run for `t` seconds, in nanoseconds."""
        return round((self._wall + t) * 1e9)

    def run(self) -> None:
        """Tick until `close`."""
        while not self._over.wait(TICK):
            self.tick()

    def close(self) -> None:
        """End `run` and notify the pages."""
        self._over.set()
        self.hub.end("the dashboard's command has ended: nothing on this page is up to date")
        if self._stream is not None:
            self._stream.close()


class FleetServer(Server):
    """HTTP server of a dashboard.

    `token`: required from a browser; "" for none. `tls`: None for plain HTTP. Raises OSError."""

    def __init__(
        self, host: str, port: int, dashboard: Dashboard, stop: Stop | None, token: str, tls: ssl.SSLContext | None
    ) -> None:
        self.address_family = socket.AF_INET6 if ":" in host else socket.AF_INET
        super().__init__(port, dashboard.hub, host=host, handler=FleetHandler)
        self.token, self.stop, self._tls, self._dashboard = token, stop, tls, dashboard
        self.cookies: list[str] = []
        name = f"[{host}]" if ":" in host else host
        self.names |= {f"{name}:{self.server_address[1]}"}
        scheme = "https" if tls else "http"
        self.url = f"{scheme}://{name}:{self.server_address[1]}/"
        self.guard = None if stop is None else ControlGuard(None if token else self.names, scheme)

    def server_bind(self) -> None:
        """Bind without a name lookup of the host, which may take seconds."""
        socketserver.TCPServer.server_bind(self)
        self.server_name, self.server_port = str(self.server_address[0]), int(self.server_address[1])

    def get_request(self) -> tuple[Any, Any]:
        """Accept a connection. The TLS handshake is left to its own thread."""
        connection, address = super().get_request()
        if self._tls is not None:
            connection = self._tls.wrap_socket(connection, server_side=True, do_handshake_on_connect=False)
        return connection, address

    @property
    def page(self) -> bytes:
        """The page of the present fleet."""
        header = self.hub.header
        title = f"{header.app or 'fleet'}, dashboard"
        before = HEAD.format(title=escape(title), stop=STOP if self.stop is not None else "")
        axis = "time since the dashboard began (s)"
        token = "" if self.guard is None else self.guard.token
        facts = {"token": token, "axis": axis, "version": self._dashboard.version}
        return page(title, header, {}, before, "", live=True, more=("fleet.js",), facts=facts).encode()


class FleetHandler(Handler):
    """Request handler that requires the token, if there is one, and accepts the emergency stop."""

    server: FleetServer

    def admitted(self) -> bool:
        """Return whether the request may be answered.

        With a token: its browser has a cookie. Without: it is addressed to this computer (see Server)."""
        if not self.server.token:
            return super().admitted()
        if any(hmac.compare_digest(self._cookie().encode(), known.encode()) for known in self.server.cookies):
            return True
        if self.command == "GET" and self.path == "/":
            self._ask("The token is in the file that the option --token names.")
        else:
            self.send_error(403, "The token is needed first")
        return False

    def do_POST(self) -> None:
        """Accept the token, or stop the fleet."""
        if self.path == "/login" and self.server.token:
            self._login()
        elif not self.admitted() or (command := self.ordered()) is None:
            return
        elif command != {"do": "stop"} or self.server.stop is None:
            self.send_error(400, "The only command is the emergency stop")
        else:
            answers = self.server.stop()
            self.server.hub.send("stopped", {"robots": answers, "by": self.client_address[0]})
            self.give("application/json", json.dumps({"robots": answers}).encode())

    def _login(self) -> None:
        length = self.headers.get("Content-Length", "")
        if not length.isdecimal() or int(length) > LONGEST_BODY:
            self.send_error(413)
            return
        sent = parse_qs(self.rfile.read(int(length)).decode("utf-8", "replace")).get("token", [""])[0]
        if not hmac.compare_digest(sent.strip().encode(), self.server.token.encode()):
            self._ask("That is not the token.")
            return
        cookie = secrets.token_urlsafe(32)
        self.server.cookies = [*self.server.cookies, cookie][-MOST_BROWSERS:]
        secure = "; Secure" if self.server.url.startswith("https") else ""
        self.send_response(303)
        self.send_header("Location", "/")
        self.send_header("Set-Cookie", f"{COOKIE}={cookie}; HttpOnly; SameSite=Strict; Path=/{secure}")
        self.send_header("Content-Length", "0")
        self.end_headers()

    def _ask(self, words: str) -> None:
        body = LOGIN.format(words=escape(words)).encode()
        self.send_response(401)
        for name, value in (
            ("Content-Type", "text/html; charset=utf-8"), ("Content-Length", str(len(body))),
            ("Cache-Control", "no-store"), ("Content-Security-Policy", LOGIN_POLICY),
        ):  # fmt: skip
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def _cookie(self) -> str:
        """Return the browser's cookie; "" if there is none."""
        try:
            found = SimpleCookie(self.headers.get("Cookie", "")).get(COOKIE)
        except CookieError:
            return ""
        return found.value if found is not None else ""
