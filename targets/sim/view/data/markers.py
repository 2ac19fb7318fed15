"""Markers (places of interest) with the states to do, taken and done: shows a program's list of tasks.

A fixed marker is done when a robot has been within its radius. The elements of the program's marker list at the
mission's start are markers, too: to do while they are in the list, taken after they have left it, done once a robot has
been within their radius after that."""

from __future__ import annotations

import math
from typing import Any

import msgspec

from koordgen.runtime.trace.schema import Header, Marker
from targets.sim.base.bodies import Vector

TO_DO, TAKEN, DONE = 0, 1, 2


class Markers:
    """Marker states during a run.

    `rows` belong to the table `markers`: t, number, state, and for the first row of a listed marker its description."""

    def __init__(self, header: Header) -> None:
        self._list = header.world.marker_list
        self._all: list[Marker] = list(header.world.markers)
        self._states = [TAKEN] * len(self._all)  # fixed markers count as taken: a robot may visit them at any time
        self._elements: dict[bytes, int] | None = None  # elements of the list: JSON -> number of the marker
        self._path = _path(header)
        self.rows: list[list[Any]] = []

    def value(self, name: str, value: Any, t: float) -> None:
        """Apply a new value of a shared variable."""
        if self._list is None or name != self._list.variable or not isinstance(value, list):
            return
        there = {msgspec.json.encode(element): element for element in value}
        if self._elements is None:
            self._elements = {}
            for element, found in there.items():
                if (place := _point(found, self._path)) is not None:
                    self._elements[element] = len(self._all)
                    self._all.append(Marker(f"{self._list.variable} {len(self._all)}", place, self._list.radius))
                    self._states.append(TO_DO)
                    self.rows.append([t, len(self._all) - 1, TO_DO, msgspec.to_builtins(self._all[-1])])
        for element, number in self._elements.items():
            if element in there and self._states[number] != TO_DO:
                self._set(number, TO_DO, t)
            elif element not in there and self._states[number] == TO_DO:
                self._set(number, TAKEN, t)

    def pose(self, position: Vector, t: float) -> None:
        """Apply a robot's position."""
        for number, marker in enumerate(self._all):
            if t >= 0 and self._states[number] == TAKEN and math.dist(position, marker.position) <= marker.radius:
                self._set(number, DONE, t)

    def _set(self, number: int, state: int, t: float) -> None:
        self._states[number] = state
        self.rows.append([t, number, state])


def _path(header: Header) -> list[int]:
    """Return the indices that lead from an element of the list to its position; [] if the element is the position."""
    found = header.world.marker_list
    if found is None or not found.position:
        return []
    of = next((v.type for v in header.shared if v.name == found.variable), "")
    fields = [name for name, _ in header.records.get(of.partition("<")[2].removesuffix(">"), ())]
    return [fields.index(found.position)] if found.position in fields else []


def _point(element: Any, path: list[int]) -> Vector | None:
    for step in path:
        element = element[step] if isinstance(element, list) and step < len(element) else None
    if isinstance(element, list) and len(element) == 3 and all(type(c) in (int, float) for c in element):
        return (float(element[0]), float(element[1]), float(element[2]))
    return None
