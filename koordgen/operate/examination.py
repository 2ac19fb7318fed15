"""Examination of a whole fleet before a mission: runs `doctor` on every robot, and shows one table.

`doctor` is a command of each robot's bundle. It checks the robot's computer, network, settings and devices.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from typing import Any

from koordgen.lang.node import Node
from koordgen.operate.hosts import HostError, Sessions, SshSession

_STATES = ("ok", "warn", "fail")
UNREACHED = 5  # exit status for a robot whose host could not be reached


class HostExamination(Node):
    """Result of one robot's `doctor`.

    status: exit status.
    checks: results of the checks, in the format of the JSON document that `doctor` prints.
    problem: reason why `checks` is empty; "" if `doctor` ran.
    """

    robot: str
    status: int
    checks: tuple[dict[str, Any], ...]
    problem: str = ""

    def count(self, state: str) -> int:
        """Return how many checks have this state."""
        return Counter(each["state"] for each in self.checks)[state]


async def examine(sessions: Sessions) -> list[HostExamination]:
    """Run `doctor` on all robots; return the results, with those of hosts that failed at the end.

    Hosts are examined in parallel, the robots of one host one after another.
    """
    found, failed = await sessions.each(_examine_host)
    missed = [(robot, error) for error in (*sessions.failed, *failed) for robot in error.host.robots]
    return [
        *(each for examined in found.values() for each in examined),
        *(HostExamination(robot, UNREACHED, (), _problem(error)) for robot, error in missed),
    ]


async def _examine_host(session: SshSession) -> list[HostExamination]:
    return [await _examine_robot(session, robot) for robot in session.host.robots]


async def _examine_robot(session: SshSession, robot: str) -> HostExamination:
    try:
        answer = await session.call("doctor", robot=robot)
    except HostError as error:
        if error.code == "link":
            raise
        return HostExamination(robot, 1, (), _problem(error))
    return HostExamination(robot, int(answer["status"]), tuple(answer["document"]["checks"]))


def _problem(error: HostError) -> str:
    return f"{error.message}" + (f"; {error.help}" if error.help else "")


def worst(examined: Sequence[HostExamination]) -> int:
    """Return the greatest exit status of all robots: 5 (surroundings), 1 (files) or 0 (no problem)."""
    return max((each.status for each in examined), default=0)


def to_json(examined: Sequence[HostExamination]) -> str:
    """Return the results of all robots' checks as one JSON document."""
    robots = [
        {"robot": each.robot, "status": each.status, "problem": each.problem, "checks": list(each.checks)}
        for each in examined
    ]
    return json.dumps({"status": worst(examined), "robots": robots}, indent=2)


def table(examined: Sequence[HostExamination]) -> str:
    """Return a table with the number of each robot's checks by state, and the checks that are not ok."""
    width = max(len("robot"), *(len(each.robot) for each in examined))
    lines = [f"{'robot':<{width}}  " + "  ".join(f"{state:>4}" for state in _STATES)]
    for each in examined:
        if each.problem:
            lines.append(f"{each.robot:<{width}}     -     -     -  {each.problem}")
            continue
        lines.append(f"{each.robot:<{width}}  " + "  ".join(f"{each.count(state):>4}" for state in _STATES))
        lines += [f"  {_line(check)}" for check in each.checks if check["state"] != "ok"]
    return "\n".join(lines)


def _line(finding: dict[str, Any]) -> str:
    state = finding["state"].upper() if finding["state"] == "fail" else finding["state"]
    wanted = f"; wanted: {finding['wanted']}" if finding["wanted"] else ""
    return f"{state:<4}  {finding['name']}: {finding['found']}{wanted}" + (
        f"; {finding['why']}" if finding["why"] else ""
    )
