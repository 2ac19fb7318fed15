"""Examination of a whole fleet before a mission: every robot's own doctor, side by side, as one table."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from typing import Any

from koordgen.lang.node import Node
from koordgen.operate.hosts import HostError, Session, Sessions

_STATES = ("ok", "warn", "fail")
UNREACHED = 5  # exit status for a robot whose doctor could not be asked


class Examined(Node):
    """One robot. `status` is its doctor's exit status; `findings` as the doctor's document has them; `problem` says why
    there are none."""

    robot: str
    status: int
    findings: tuple[dict[str, Any], ...]
    problem: str = ""

    def count(self, state: str) -> int:
        """Return how many findings have this state."""
        return Counter(each["state"] for each in self.findings)[state]


async def examine(sessions: Sessions) -> list[Examined]:
    """Let the doctors of all robots look, those of one host after one another; hosts that failed stand last."""
    found, failed = await sessions.each(_examine_host)
    missed = [(robot, error) for error in (*sessions.failed, *failed) for robot in error.host.robots]
    return [
        *(each for examined in found.values() for each in examined),
        *(Examined(robot, UNREACHED, (), _problem(error)) for robot, error in missed),
    ]


async def _examine_host(session: Session) -> list[Examined]:
    return [await _examine_robot(session, robot) for robot in session.host.robots]


async def _examine_robot(session: Session, robot: str) -> Examined:
    try:
        answer = await session.call("doctor", robot=robot)
    except HostError as error:
        if error.code == "link":
            raise
        return Examined(robot, 1, (), _problem(error))
    return Examined(robot, int(answer["status"]), tuple(answer["document"]["findings"]))


def _problem(error: HostError) -> str:
    return f"{error.message}" + (f"; {error.help}" if error.help else "")


def worst(examined: Sequence[Examined]) -> int:
    """Return the exit status of the worst robot: 5 (surroundings) is worse than 1 (files), which is worse than 0."""
    return max((each.status for each in examined), default=0)


def to_json(examined: Sequence[Examined]) -> str:
    """Return all robots' findings as one JSON document."""
    robots = [
        {"robot": each.robot, "status": each.status, "problem": each.problem, "findings": list(each.findings)}
        for each in examined
    ]
    return json.dumps({"status": worst(examined), "robots": robots}, indent=2)


def table(examined: Sequence[Examined]) -> str:
    """Return a line for each robot with the number of its findings by state, below it those that are not ok."""
    width = max(len("robot"), *(len(each.robot) for each in examined))
    lines = [f"{'robot':<{width}}  " + "  ".join(f"{state:>4}" for state in _STATES)]
    for each in examined:
        if each.problem:
            lines.append(f"{each.robot:<{width}}     -     -     -  {each.problem}")
            continue
        lines.append(f"{each.robot:<{width}}  " + "  ".join(f"{each.count(state):>4}" for state in _STATES))
        lines += [f"  {_line(finding)}" for finding in each.findings if finding["state"] != "ok"]
    return "\n".join(lines)


def _line(finding: dict[str, Any]) -> str:
    state = finding["state"].upper() if finding["state"] == "fail" else finding["state"]
    wanted = f"; wanted: {finding['wanted']}" if finding["wanted"] else ""
    return f"{state:<4}  {finding['name']}: {finding['found']}{wanted}" + (
        f"; {finding['why']}" if finding["why"] else ""
    )
