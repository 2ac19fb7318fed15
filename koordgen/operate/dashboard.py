"""Data source of the dashboard: requests the status of all robots 4 times a second.

Each robot has its own thread, so a robot that does not answer, or a slow name lookup, delays no other robot. As long as
a robot answers, its report is shown at most EVERY + WITHIN seconds after the agent made it.
The requests change nothing on any robot.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from koordgen.lang.node import Node
from koordgen.operate.estop import Contact, Place, StoppableFleet
from koordgen.operate.status import StatusAnswer, ask_one, odd_releases

EVERY = 0.25  # seconds from one status request to a robot to the next
WITHIN = 0.5  # seconds that a robot has to answer a request

OnAnswer = Callable[[int, StatusAnswer], None]


class Poller:
    """Poller: requests the status of all robots periodically until it is closed.

    `on_answer` is called with a robot's index in `fleet` and the robot's answer, with or without a report.
    Several threads call `on_answer`.
    """

    def __init__(self, fleet: Sequence[Contact], on_answer: OnAnswer) -> None:
        self._fleet, self._on_answer = fleet, on_answer
        self._over = threading.Event()
        self._last: dict[int, StatusAnswer] = {}  # last answer of each robot that has answered
        self._threads = [threading.Thread(target=self._ask, args=(index,), daemon=True) for index in range(len(fleet))]

    def start(self) -> None:
        """Start to poll all robots."""
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """Stop polling and end all threads. Afterwards `on_answer` is not called any more."""
        self._over.set()
        for thread in self._threads:
            thread.join()

    @property
    def odd(self) -> frozenset[str]:
        """Return the robots whose release, in their last answer, differs from the release of most robots."""
        return frozenset(odd_releases(list(self._last.values())))

    def _ask(self, index: int) -> None:
        while not self._over.is_set():
            began = time.monotonic()
            asked = ask_one(self._fleet[index], began, WITHIN)
            if asked.report is not None:
                self._last[index] = asked
            self._on_answer(index, asked)
            self._over.wait(max(0.0, began + EVERY - time.monotonic()))


class RowsOfLevels:
    """Distributor of answers to the rows of the dashboard: one for each physical robot, and one for each squad.

    The row of a squad is above those of its robots, and shows what its host reports of it. Robots of all levels have
    one numbering there, that of the rows. So the pids in reports are replaced, and names of the applications and
    variables of a squad's fleet begin with the squad's name. Without squads, answers are passed on as they are.

    `show` is called with a row, its report, or None, and a note.
    """

    def __init__(self, fleet: Sequence[Contact], show: Callable[[int, Mapping[str, Any] | None, str], None]) -> None:
        names = [contact.place.name for contact in fleet]
        squads = [name.rpartition(".")[0] for name in names]
        self.squads = frozenset(squads) - {""}
        above = dict.fromkeys(name for pair in zip(squads, names, strict=True) for name in pair if name)
        self.names = list(above) if self.squads else names
        self._rows = {name: row for row, name in enumerate(self.names)} if self.squads else {}
        self._show = show
        self._hosts: dict[str, str] = {}  # squad -> robot that hosts it

    def on_answer(self, index: int, asked: StatusAnswer) -> None:
        """Pass on the answer of the physical robot with this index."""
        if not self.squads:
            self._show(index, asked.report, asked.note)
            return
        name, report, note = asked.place.name, asked.report, asked.note
        squad = name.rpartition(".")[0]
        try:
            shown = None if report is None else self._renumbered(squad, report)
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:  # of another release
            report, shown, note = None, None, f"its report cannot be read: {error!r}"
        self._show(self._rows[name], shown, note)
        if squad:
            self._show_squad(squad, name, {} if report is None else report)

    def _show_squad(self, squad: str, name: str, report: Mapping[str, Any]) -> None:
        outer = report.get("outer", {})
        if "phase" in outer:
            self._hosts[squad] = name
            known = {key: report[key] for key in ("release", "boot") if key in report}
            own = {key: value for key, value in outer.items() if key not in ("robot", "host")}
            self._show(self._rows[squad], {**known, **own}, f"hosted by {name}")
        elif self._hosts.get(squad, name) == name:
            self._show(self._rows[squad], None, "no robot of it reports that it hosts it")

    def _renumbered(self, squad: str, report: Mapping[str, Any]) -> dict[str, Any]:
        """Return a report with the numbers of rows in place of the pids of a fleet. `squad`: "" for the outer fleet."""
        prefix = f"{squad}." if squad else ""
        rows = [self._rows.get(f"{prefix}{name}", 0) for name in report.get("names", ())]
        changed = dict(report)
        changed["peers"] = {str(rows[int(pid)]): each for pid, each in report.get("peers", {}).items()}
        if squad:
            changed["applications"] = [
                {**each, "name": f"{prefix}{each['name']}", "members": [rows[pid] for pid in each["members"]]}
                for each in report.get("applications", ())
            ]
            changed["shared"] = [[f"{prefix}{name}", *more] for name, *more in report.get("shared", ())]
            changed["outcomes"] = [
                [first, count, outcome, f"{prefix}{detail}", late]
                for first, count, outcome, detail, late in report.get("outcomes", ())
            ]
        return changed


class Facts(Node):
    """Facts about a fleet that the robots do not report themselves.

    fleet: the robots in the order of their process ids (pid: index of a robot in the fleet).
    plain: JSON-like values: obstacles, world, and the target of each robot.
    """

    fleet: StoppableFleet
    plain: Mapping[str, Any]


def built_facts(fleet: StoppableFleet, path: Path) -> Facts:
    """Return the facts in the robots' settings, from a folder of `koordgen build` or of a simulated run.

    A robot that is named only in the settings of other robots is listed with port 0.
    """
    found: list[dict[str, Any]] = []
    for file in sorted(path.glob("**/settings.json")):
        with suppress(OSError, ValueError):
            settings = json.loads(file.read_bytes())
            if isinstance(settings, dict) and isinstance(settings.get("peers"), list):
                found.append(settings)
    places = {place.name: place for place in fleet.places}
    peers = found[0]["peers"] if found else []
    names = [str(peer.get("name")) for peer in peers if isinstance(peer, dict)]
    if not set(places) <= set(names):
        return Facts(fleet, {})
    ordered = tuple([places.get(name, Place(name, "", 0)) for name in names])
    plain = {"obstacles": found[0].get("obstacles", [])}
    return Facts(StoppableFleet(ordered, fleet.application, fleet.key, fleet.folder), plain)
