"""Data source of the dashboard: asks all robots of a fleet a few times a second over their control ports.

Each robot has a thread of its own, so a robot that does not answer, or whose name takes long to be looked up, delays no
other robot. A report is shown at most EVERY + WITHIN seconds after the agent made it, as long as the robot answers.
Nothing is changed on any robot.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from koordgen.lang.node import Node
from koordgen.operate.estop import Fleet, Place
from koordgen.operate.status import Asked, ask_one, odd_releases

EVERY = 0.25  # seconds from one question to a robot to the next
WITHIN = 0.5  # seconds that an answer may take

Take = Callable[[int, Asked], None]


class Poller:
    """Asks robots until it is closed. `take` gets each answer with the robot's index in the fleet's places, also those
    without a report; several threads call it."""

    def __init__(self, fleet: Fleet, key: bytes | None, take: Take) -> None:
        self._fleet, self._key, self._take = fleet, key, take
        self._over = threading.Event()
        self._last: dict[int, Asked] = {}  # the last answer of each robot that ever answered
        self._threads = [
            threading.Thread(target=self._ask, args=(index,), daemon=True) for index in range(len(fleet.places))
        ]

    def start(self) -> None:
        """Begin to ask."""
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """End all threads. Returns when no further answer will be taken."""
        self._over.set()
        for thread in self._threads:
            thread.join()

    @property
    def odd(self) -> frozenset[str]:
        """Names of the robots whose release is not the one that most robots run, by their last answers."""
        return frozenset(odd_releases(list(self._last.values())))

    def _ask(self, index: int) -> None:
        place, application = self._fleet.places[index], self._fleet.application
        while not self._over.is_set():
            began = time.monotonic()
            asked = ask_one(place, application, self._key, began, WITHIN)
            if asked.report is not None:
                self._last[index] = asked
            self._take(index, asked)
            self._over.wait(max(0.0, began + EVERY - time.monotonic()))


class Facts(Node):
    """Facts about a fleet that its robots do not report. `fleet` has the robots in the order of their pids; `plain` are
    plain values: obstacles, world, the targets by robot."""

    fleet: Fleet
    plain: Mapping[str, Any]


def built_facts(fleet: Fleet, path: Path) -> Facts:
    """Return the facts that stand in the settings of a folder that `koordgen build` wrote, or a simulated run. A robot
    that other robots' settings name, and that has no folder there, is listed without a port."""
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
    return Facts(Fleet(ordered, fleet.application, fleet.key, fleet.folder), plain)
