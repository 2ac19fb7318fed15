"""Status of a whole fleet: asks each robot's agent over its control port, and shows one table.

The row of a robot that does not answer gives the reason. If its host is asked over SSH (koordgen/operate/installed.py),
the row shows the host's answer. Nothing is changed on any robot.

A squad, a robot that is a fleet itself, has a row above its robots: the one that hosts it reports its state.
"""

from __future__ import annotations

import json
import os
import socket
import threading
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

from koordgen.lang.node import Node, replace
from koordgen.operate.estop import Contact, Place
from koordgen.operate.installed import Installed
from koordgen.runtime.ops.orders import LONG, NONCE
from koordgen.runtime.ops.status import StatusRequest, applications_table

ANSWER_TIMEOUT = 2.0  # longest wait for the answers in seconds; all robots are asked in parallel
_REPEAT = 0.05  # seconds between two requests to one robot
_COLUMNS = (
    "robot", "release", "phase", "round", "current", "loss", "late ms", "clock ms", "battery", "disk", "temp", "notes",
)  # fmt: skip


class StatusAnswer(Node):
    """Answer of one robot.

    place: address and port to which the request was sent.
    report: status report of the agent; None without an answer.
    after: seconds until the answer.
    note: reason why there is no answer, or what is wrong with the answer.
    host: answer of the robot's host over SSH; None if the host was not asked.
    """

    place: Place
    report: Mapping[str, Any] | None
    after: float
    note: str
    host: Installed | None = None


class SquadStatus(Node):
    """State of a robot that is a fleet itself.

    members: its robots, as SQUAD.ROBOT.
    host: member that runs its agent; empty if no member reports that it does.
    release: release that the host runs.
    report: its state, as its host reports it: phase, round, pose, goal; None without a host.
    """

    name: str
    members: tuple[str, ...]
    host: str
    release: str
    report: Mapping[str, Any] | None

    @property
    def note(self) -> str:
        """Return its host and its position as text."""
        if self.report is None:
            return "no robot of it reports that it hosts it"
        pose = self.report.get("pose")
        place = "unknown" if pose is None else ", ".join(f"{value:.2f}" for value in pose["position"])
        return f"hosted by {self.host}; position (m): {place}"


def squads_of(answers: Sequence[StatusAnswer]) -> dict[str, SquadStatus]:
    """Return the state of each squad by its name."""
    members: dict[str, list[StatusAnswer]] = {}
    for each in answers:
        if squad := each.place.name.rpartition(".")[0]:
            members.setdefault(squad, []).append(each)
    return {squad: _squad_status(squad, found) for squad, found in members.items()}


def _squad_status(squad: str, members: Sequence[StatusAnswer]) -> SquadStatus:
    names = tuple([each.place.name for each in members])
    hosts = [each for each in members if each.report is not None and "phase" in each.report.get("outer", {})]
    if not hosts:
        return SquadStatus(squad, names, "", "", None)
    # an earlier host that is cut off from the others may not know yet that it has been replaced
    host = max(hosts, key=lambda each: each.report["outer"]["round"] if each.report else 0)
    assert host.report is not None
    return SquadStatus(squad, names, host.place.name, release_of(host), host.report["outer"])


def ask_all(fleet: Sequence[Contact], timeout: float = ANSWER_TIMEOUT) -> list[StatusAnswer]:
    """Ask all robots in parallel for at most `timeout` seconds. Return the answers in the order of the robots."""
    answers = [StatusAnswer(contact.place, None, timeout, "no answer") for contact in fleet]
    began = time.monotonic()

    def ask(index: int) -> None:
        answers[index] = ask_one(fleet[index], began, timeout)

    threads = [threading.Thread(target=ask, args=(i,), daemon=True) for i in range(len(answers))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(max(0.0, began + timeout + 0.2 - time.monotonic()))
    return list(answers)


def ask_one(asked: Contact, began: float, timeout: float) -> StatusAnswer:
    """Ask one robot repeatedly until it answers, or `timeout` seconds have passed since `began`.

    `began` is a monotonic time.
    """
    place = asked.place
    if asked.trouble:
        return StatusAnswer(place, None, 0.0, f"no answer: {asked.trouble}")
    if not place.port:
        return StatusAnswer(place, None, 0.0, "the fleet file has no address for the robot")
    try:
        family, *_, address = socket.getaddrinfo(place.host, place.port, type=socket.SOCK_DGRAM)[0]
    except (OSError, UnicodeError) as error:
        return StatusAnswer(place, None, 0.0, f"no address: {error}")
    asking, note = StatusRequest(asked.application, asked.key, os.urandom(NONCE)), "no answer"
    with socket.socket(family, socket.SOCK_DGRAM) as asker:
        with suppress(OSError):
            asker.connect(address)
        while asking.answer is None and (now := time.monotonic()) < began + timeout:
            try:
                for datagram in asking.datagrams():
                    asker.send(datagram)
                _listen(asker, asking, now + _REPEAT)
            except TimeoutError:
                continue
            except ConnectionRefusedError:
                note = "no answer: no agent runs at this address"
                time.sleep(_REPEAT)
            except OSError as error:
                note = f"no answer: {error.strerror or error}"
                time.sleep(_REPEAT)
    after = time.monotonic() - began
    if asking.answer is None:
        return StatusAnswer(place, None, after, note)
    name = asking.answer.get("robot")
    return StatusAnswer(place, asking.answer, after, "" if name == asked.robot else f"it says that it is {name}")


def _listen(asker: socket.socket, asking: StatusRequest, until: float) -> None:
    """Receive one robot's answer until it is complete or the next request is due.

    Raises TimeoutError at `until`.
    """
    while (left := until - time.monotonic()) > 0:
        asker.settimeout(left)
        if asking.receive(asker.recv(LONG + 1)):
            return


def with_hosts(
    answers: Sequence[StatusAnswer], found: Mapping[str, Installed], failed: Mapping[str, str]
) -> list[StatusAnswer]:
    """Return the answers, completed for robots that did not answer.

    Their answers get the state of their host (`found`), or the failure of their host (`failed`).
    """
    return [
        replace(a, host=found[a.place.name], note=found[a.place.name].note)
        if a.place.name in found
        else replace(a, note=f"{a.note}; SSH: {failed[a.place.name]}")
        if a.place.name in failed
        else a
        for a in answers
    ]


def release_of(asked: StatusAnswer) -> str:
    """Return the release that a robot runs, or would run if it were started; empty if unknown."""
    if asked.report is not None:
        return str(asked.report.get("release", ""))
    return asked.host.release if asked.host is not None else ""


def odd_releases(answers: Sequence[StatusAnswer]) -> dict[str, str]:
    """Return robot -> release for the robots whose release differs from the release of most robots.

    A release may be running or installed. The result is empty when all releases are equal. A fleet with several
    releases cannot begin a mission.
    """
    # release ids also depend on the key, so hosts with different keys have different ids
    hosts = {a.place.name: a.host.id for a in answers if a.host is not None}
    builds = {a.place.name: release_of(a) for a in answers if a.report is not None or a.host is not None}
    return _odd(hosts) | _odd(builds)


def _odd(releases: Mapping[str, str]) -> dict[str, str]:
    counted = Counter(releases.values()).most_common()
    return {name: release for name, release in releases.items() if release != counted[0][0]}


def to_json(answers: Sequence[StatusAnswer]) -> str:
    """Return all answers as one JSON document."""
    robots = [
        {
            "robot": a.place.name,
            "address": f"{a.place.host}:{a.place.port}",
            "answered": a.report is not None,
            "after_ms": round(a.after * 1e3, 1) if a.report is not None else None,
            "note": a.note,
            "report": a.report,
            "host": a.host and a.host.to_data(),
        }
        for a in answers
    ]
    found = {"robots": robots, "odd_releases": odd_releases(answers)}
    if squads := squads_of(answers):
        found["squads"] = [
            {"robot": s.name, "members": s.members, "host": s.host or None, "report": s.report}
            for s in squads.values()
        ]  # fmt: skip
    return json.dumps(found, indent=2)


def table(answers: Sequence[StatusAnswer]) -> str:
    """Return a table with a line for each robot, and a last line for robots with a different release.

    Lines of a squad's robots follow the line of the squad. A second table shows the applications of the robots, if they
    have several.
    """
    squads = squads_of(answers)
    rows: list[tuple[str, ...]] = [_COLUMNS]
    for answer in answers:
        squad = squads.get(answer.place.name.rpartition(".")[0])
        if squad is None:
            rows.append(_row(answer))
            continue
        if squad.members[0] == answer.place.name:
            rows.append(_squad_row(squad))
        name, *others = _row(answer)
        rows.append((f"  {name}", *others))
    widths = [max(len(row[i]) for row in rows) for i in range(len(_COLUMNS))]
    lines = ["  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    of_robots = applications_table([(a.place.name, a.report) for a in answers if a.report is not None])
    lines += ["", *of_robots[:-1]] if of_robots else []
    if odd := odd_releases(answers):
        named = ", ".join(f"{name} ({release[:8] or 'none'})" for name, release in odd.items())
        lines.append(f"robots whose release differs from most: {named}; a mission needs one release on all robots")
    return "\n".join(lines)


def _row(asked: StatusAnswer) -> tuple[str, ...]:
    report = asked.report
    if report is None:
        return _silent_row(asked)
    host = report.get("host", {})
    losses = [peer["loss"] for peer in report["peers"].values() if peer["loss"] is not None]
    violated = [f"violated: {each['of']} {each['name']}".strip() for each in report["monitors"]["violated"]]
    return (
        asked.place.name,
        str(report.get("release", ""))[:8] or "none",
        report["phase"],
        str(report["round"]),
        f"{100 * report['current'] / report['rounds']:.1f} %" if report["rounds"] else "-",
        f"{100 * max(losses):.1f} %" if losses else "-",
        f"{report['late_ms']['p99']:.1f}" if report["late_ms"] else "-",
        _number(host.get("clock_ms"), "{:.2f}"),
        _number(report.get("battery"), "{:.0%}"),
        _number(host.get("disk_gb"), "{:.1f} GB"),
        _number(host.get("temperature"), "{:.0f} °C"),
        "; ".join([asked.note] * bool(asked.note) + violated),
    )


def _squad_row(squad: SquadStatus) -> tuple[str, ...]:
    report = squad.report or {}
    known = (squad.release[:8] or "-", str(report.get("phase", "-")), str(report.get("round", "-")))
    battery = _number(report.get("battery"), "{:.0%}")
    return (squad.name, *known, "-", "-", "-", "-", battery, "-", "-", squad.note)


def _silent_row(asked: StatusAnswer) -> tuple[str, ...]:
    """Return the row of a robot whose agent gave no answer.

    The row shows the answer of the robot's host if the host was asked.
    """
    note = f"{asked.note} ({asked.place.host}:{asked.place.port})"
    if (host := asked.host) is None:
        return (asked.place.name, *("-",) * (len(_COLUMNS) - 2), note)
    temperature = _number(host.temperature, "{:.0f} °C")
    unknown = ("-",) * (len(_COLUMNS) - 5)
    return (asked.place.name, host.release[:8] or "none", *unknown, f"{host.free / 1e9:.1f} GB", temperature, note)


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)
