"""Start and stop of the agents on a fleet's hosts.

Agents start only if all hosts of the named robots have the same confirmed release; otherwise none starts. A stop is
orderly: each agent gets SIGTERM and brings its robot to a safe stop (a quad lands, a car brakes).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from koordgen.lang.node import Node
from koordgen.operate.hosts import Host, HostError, Sessions

STOP_WITHIN = 30.0  # longest time until an agent must end after SIGTERM, in seconds


class ServiceRefused(Exception):
    """Raised if no agent was started.

    The message names the robots and the reason; `help` says what to do.
    """

    def __init__(self, message: str, help: str) -> None:
        super().__init__(message)
        self.help = help


class Done(Node):
    """Result of a start or stop.

    robots: robots whose agents were started or stopped.
    idle: robots whose agents ran already (start), or did not run (stop).
    release: the confirmed release (start); empty for a stop.
    failed: failures of hosts.
    """

    robots: tuple[str, ...]
    idle: tuple[str, ...]
    release: str
    failed: tuple[HostError, ...]


async def start(sessions: Sessions) -> Done:
    """Start the agents of all robots of the sessions' hosts.

    Raises Refused, or HostError if a host cannot be inspected; then no agent was started.
    """
    inspected, failed = await sessions.call("inspect")
    for error in (*sessions.failed, *failed):
        raise error
    release = confirmed({host: answer["deployment"] for host, answer in inspected.items()})
    started, failed = await sessions.each(lambda session: session.call("start", robots=list(session.host.robots)))
    states = {robot: state for answer in started.values() for robot, state in answer["robots"].items()}
    running = tuple(robot for robot, state in states.items() if state == "running")  # robots whose agents ran already
    return Done(tuple(robot for robot in states if robot not in running), running, release, tuple(failed))


async def stop(sessions: Sessions, seconds: float = STOP_WITHIN) -> Done:
    """Stop the agents on all hosts that can be reached, and wait at most `seconds` for their end."""
    stopped, failed = await sessions.each(
        lambda session: session.call("stop", robots=list(session.host.robots), seconds=seconds)
    )
    ended = tuple(robot for answer in stopped.values() for robot in answer["stopped"])
    idle = tuple(robot for host in stopped for robot in host.robots if robot not in ended)
    return Done(ended, idle, "", (*sessions.failed, *failed))


def confirmed(deployments: Mapping[Host, Mapping[str, Any]]) -> str:
    """Return the release that all hosts have confirmed. Raises Refused if there is no such release."""
    deploy = "`koordgen deploy APP.koord --fleet FLEET` brings all robots to one release; nothing was started"
    pending = {host: each["pending"]["id"] for host, each in deployments.items() if each["pending"]}
    if pending:
        named = "; ".join(f"{', '.join(host.robots)}: {id_[:8]}" for host, id_ in pending.items())
        raise ServiceRefused(
            f"a release is not confirmed yet ({named})", f"wait for the deployment to end, or deploy again: {deploy}"
        )
    without = [robot for host, each in deployments.items() if not each["confirmed"] for robot in host.robots]
    if without:
        raise ServiceRefused(f"there is no release on {', '.join(without)}", deploy)
    releases: dict[str, list[str]] = {}
    for host, each in deployments.items():
        releases.setdefault(each["confirmed"], []).extend(host.robots)
    if len(releases) > 1:
        named = "; ".join(f"{id_[:8]} on {', '.join(robots)}" for id_, robots in releases.items())
        raise ServiceRefused(f"the robots have different releases: {named}", deploy)
    return next(iter(releases))
