"""Distance field: the length of the shortest path around obstacles to a place, for a point instead of a car.

The search over poses uses it as its heuristic. The field is computed by breadth-first search over square cells. Steps
go alternately to all eight neighbours and to the four nearest ones. So the cells that are reached in a number of steps
form an octagon, within 6 % of a circle. Metres, local ENU.
"""

from __future__ import annotations

import math

import numpy as np

from targets.car.planning.overlap import Floats, Indices, Mask
from targets.car.planning.planner import Area

MOST_CELLS = 250_000
STEP = 1.06  # length of a step in cell widths: mean over all directions, which range from 1 to 1.12
FAR = 1e6  # metres; distance of cells from which no path leads to the place


class Cells:
    """Square cells over an area, at least `size` metres wide, with an edge of cells around the area."""

    def __init__(self, area: Area, size: float) -> None:
        width, height = area.east - area.west, area.north - area.south
        self.size = max(size, math.sqrt(width * height / MOST_CELLS))
        self._west, self._south = area.west - self.size, area.south - self.size
        self.columns, self._rows = math.ceil(width / self.size) + 3, math.ceil(height / self.size) + 3
        row, column = np.divmod(np.arange(self._rows * self.columns), self.columns)
        # Coordinates of the middles of all cells.
        self.x, self.y = self._west + self.size * column, self._south + self.size * row
        self.edge: Mask = (row == 0) | (row == self._rows - 1) | (column == 0) | (column == self.columns - 1)

    def numbers(self, x: Floats, y: Floats) -> Indices:
        """Return the numbers of the cells in which places lie; for a place outside, the nearest cell of the area."""
        column = np.minimum(np.maximum((x - self._west) / self.size + 0.5, 1), self.columns - 2).astype(np.intp)
        row = np.minimum(np.maximum((y - self._south) / self.size + 0.5, 1), self._rows - 2).astype(np.intp)
        return row * self.columns + column


class Field:
    """Distances (m) to `place` along paths through the cells that are `free`."""

    def __init__(self, place: tuple[float, float], cells: Cells, free: Mask) -> None:
        self._cells = cells
        steps = np.full(len(free), -1)
        steps[cells.edge] = round(FAR)
        across = cells.columns
        four = np.array((1, -1, across, -across))
        eight = np.array((1, -1, across, -across, across + 1, across - 1, 1 - across, -1 - across))
        front = cells.numbers(np.array(place[:1]), np.array(place[1:]))
        steps[front] = number = 0
        while len(front):
            number += 1
            onto = (front[:, None] + (eight if number % 2 else four)).ravel()
            onto = onto[steps[onto] < 0]
            steps[onto] = number  # occupied cells get a number, too, but no path continues from them
            front = np.unique(onto[free[onto]])
        self._left = np.where(steps < 0, FAR, steps * (STEP * cells.size))

    def __call__(self, x: Floats, y: Floats) -> Floats:
        """Return the distances (m) from places to the field's place; FAR where no path leads to it."""
        return self._left[self._cells.numbers(x, y)]
