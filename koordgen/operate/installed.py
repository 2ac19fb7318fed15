"""State of robots whose agents do not answer, as their hosts report it over SSH."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from koordgen.lang.node import Node
from koordgen.operate.hosts import Answer, HostError, Sessions


class Installed(Node):
    """State of a robot and its host, as the host reports it.

    release: build that would run if the agent were started; empty if there is no build.
    id: id of the confirmed release; empty if there is no such release.
    pending: id of a release that is not confirmed yet; empty if there is no such release.
    running: True if the robot's agent runs.
    phase: phase of the agent; empty if unknown.
    free: free bytes on the disk.
    temperature: degrees Celsius; None if unknown.
    uptime: seconds since the host's boot.
    """

    release: str
    id: str
    pending: str
    running: bool
    phase: str
    free: int
    temperature: float | None
    uptime: float

    @property
    def note(self) -> str:
        """Return the robot's state as text for messages."""
        agent = (
            f"its agent runs ({self.phase or 'phase unknown'}), but does not answer"
            if self.running
            else "its agent does not run"
        )
        said = [agent if self.release else "no release is there", f"host up for {_duration(self.uptime)}"]
        if self.pending:
            said.append(f"release {self.pending[:8]} is not confirmed")
        return "; ".join(said)

    def to_data(self) -> dict[str, Any]:
        """Return the fields as a dictionary, as `status --format json` prints them."""
        return {name: getattr(self, name) for name in type(self).__match_args__}


async def installed(sessions: Sessions) -> tuple[dict[str, Installed], dict[str, HostError]]:
    """Ask all hosts; return each robot's state, and the failures of hosts by robot."""
    answers, failed = await sessions.call("inspect")
    found = {robot: of_robot(robot, answer) for host, answer in answers.items() for robot in host.robots}
    return found, {robot: error for error in (*sessions.failed, *failed) for robot in error.host.robots}


def of_robot(robot: str, answer: Answer | Mapping[str, Any]) -> Installed:
    """Return one robot's state from the answer of its host."""
    deployment, agent = answer["deployment"], answer["robots"].get(robot) or {}
    pending = deployment["pending"]
    return Installed(
        str(answer["builds"].get(robot, "")),
        deployment["confirmed"] or "",
        pending["id"] if pending else "",
        bool(agent.get("running")),
        agent.get("phase") or "",
        int(answer["free"]),
        answer["temperature"],
        float(answer["uptime"]),
    )


def _duration(seconds: float) -> str:
    minutes, hours, days = seconds / 60, seconds / 3600, seconds / 86400
    return f"{minutes:.0f} min" if hours < 2 else f"{hours:.0f} h" if days < 2 else f"{days:.0f} days"
