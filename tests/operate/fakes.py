"""Hosts that answer from memory, for tests of what is done with answers."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from koordgen.fleet.deployment import Login
from koordgen.operate.hosts import Answer, Host, HostError, Sessions, SshSession


def host(*robots: str) -> Host:
    return Host(Login("pi", f"{robots[0]}.local", None), robots, "koordgen/fleet", "python3")


class FakeSession(SshSession):
    """Answers each verb by the method of that name below; `calls` are the requests, `broken` verbs fail."""

    def __init__(self, *robots: str, confirmed: str | None = "a" * 16, pending: str | None = None) -> None:
        self.host = host(*robots)
        self.calls: list[tuple[str, dict[str, Any]]] = []
        self.broken: set[str] = set()
        self.deployment: dict[str, Any] = {
            "confirmed": confirmed,
            "history": [],
            "pending": {"id": pending} if pending else None,
        }
        self.traces: dict[str, Path] = {}  # robot -> folder of its traces
        self.lines: dict[str, list[tuple[float, str]]] = {}
        self.fetched = 0  # bytes
        self.ahead = 0.0  # seconds by which its clock is ahead
        self.cut_after = 1 << 40  # bytes after which the link is cut

    async def call(self, verb: str, data: bytes = b"", **arguments: Any) -> Answer:
        self.calls.append((verb, arguments))
        if verb in self.broken:
            raise HostError(self.host, "link", f"the link was cut during `{verb}`", "run the command again")
        answer = getattr(self, f"answer_{verb}")(**arguments)
        return answer if isinstance(answer, Answer) else Answer(answer)

    def answer_inspect(self) -> dict[str, Any]:
        return {"deployment": self.deployment}

    def answer_ping(self) -> dict[str, Any]:
        return {"clock": time.time() + self.ahead}

    def answer_source(self, id: str, robot: str) -> dict[str, Any]:
        return {"files": {"a.koord": id}}

    def answer_start(self, robots: list[str]) -> dict[str, Any]:
        return {"robots": {robot: "running" if robot == "bert" else "ready" for robot in robots}}

    def answer_stop(self, robots: list[str], seconds: float) -> dict[str, Any]:
        return {"stopped": [robot for robot in robots if robot != "bert"]}

    def answer_traces(self, robot: str) -> dict[str, Any]:
        files = sorted(self.traces[robot].iterdir())
        return {"files": [{"name": path.name, "size": path.stat().st_size} for path in files]}

    def answer_fetch(self, robot: str, file: str, offset: int, length: int) -> Answer:
        answer = Answer()
        answer.data = (self.traces[robot] / file).read_bytes()[offset : offset + length]
        self.fetched += len(answer.data)
        if self.fetched > self.cut_after:
            raise HostError(self.host, "link", "the link was cut during `fetch`", "run the command again")
        return answer

    def answer_logs(self, robot: str, since: float | None = None, lines: int | None = None) -> dict[str, Any]:
        found = [line for line in self.lines.get(robot, []) if since is None or line[0] > since]
        found = found[:2] if lines is None else found[-lines:]
        return {"lines": [list(line) for line in found], "next": found[-1][0] if found else since or 0.0}


def reached(*sessions: FakeSession, failed: tuple[HostError, ...] = ()) -> Sessions:
    return Sessions(sessions, failed)


def unreachable(*robots: str) -> HostError:
    return HostError(host(*robots), "unreachable", "refuses connections", "is its SSH server on?")
