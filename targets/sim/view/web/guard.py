"""Guard of a page's control channel: accepts commands only from the page itself.

A command changes a run. So a request must name this server as its host (against DNS rebinding), come from no other site
(`Origin`), be of a kind that a browser sends only to its own site (a custom header, and JSON), and have the token. The
token is in the page and nowhere else. Every program of this computer can load the page: do not serve it on a computer
with untrusted users."""

from __future__ import annotations

import hmac
import json
import secrets
from collections.abc import Collection
from email.message import Message
from typing import Any

PATH = "/control"
HEADER = "X-Koordgen-Token"
MOST_BYTES = 2048  # of a command
Refusal = tuple[int, str]  # HTTP status and reason


class ControlGuard:
    """Check of requests to PATH.

    `names`: hosts with port by which this server may be called; None: any, because a cookie of this server has already
    authenticated the browser."""

    def __init__(self, names: Collection[str] | None, scheme: str = "http") -> None:
        self.token = secrets.token_urlsafe(32)
        self._names, self._scheme = names, scheme

    def refusal(self, path: str, headers: Message) -> Refusal | None:
        """Return why a request is refused by its path and headers; None if its body may be read."""
        given, hosts = headers.get_all(HEADER) or [], headers.get_all("Host") or []
        names = hosts[:1] if self._names is None else self._names
        if hosts not in [[name] for name in names]:
            return 403, "This page is for the computer it runs on"
        if path != PATH:
            return 404, "There are no other commands"
        if any(
            origin not in {f"{self._scheme}://{name}" for name in names} for origin in headers.get_all("Origin") or []
        ):
            return 403, "Commands come from the page itself, not from another site"
        if len(given) != 1 or not hmac.compare_digest(given[0].encode(), self.token.encode()):
            return 403, "The token is missing or wrong: load the page again"
        if headers.get_content_type() != "application/json" or headers.get("Transfer-Encoding"):
            return 415, "A command is JSON"
        if not 0 < self.length(headers) <= MOST_BYTES:
            return 413, f"A command has 1 to {MOST_BYTES} bytes"
        return None

    def length(self, headers: Message) -> int:
        """Return the length of the body in bytes; 0 if it is missing or invalid."""
        lengths = headers.get_all("Content-Length") or []
        sound = len(lengths) == 1 and lengths[0].isascii() and lengths[0].isdecimal() and len(lengths[0]) < 10
        return int(lengths[0]) if sound else 0

    def command(self, body: bytes) -> dict[str, Any] | None:
        """Return the body's JSON object; None if it is not one."""
        try:
            found = json.loads(body)
        except (ValueError, RecursionError):
            return None
        return found if isinstance(found, dict) else None
