"""Distance field: distances to a place around obstacles, for a point. It is the heuristic of a search over poses.

Breadth first over square cells: steps go to all eight neighbours and to the four nearest in turn, so that what is
reached in the same number of steps is an octagon, within 6 % of a circle. Metres, local ENU.
"""

from __future__ import annotations

import math

import numpy as np

from targets.car.planning.overlap import Floats, Indices, Mask
from targets.car.planning.planner import Area

MOST_CELLS = 250_000
STEP = 1.06  # widths of a cell that a step comes farther, in the mean over all directions: 1 to 1.12
FAR = 1e6  # metres; distance of cells from which no path leads to the place


class Cells:
    """Square cells over an area, no narrower than `size`, with an edge of cells around it that is not part of it."""

    def __init__(self, area: Area, size: float) -> None:
        width, height = area.east - area.west, area.north - area.south
        self.size = max(size, math.sqrt(width * height / MOST_CELLS))
        self._west, self._south = area.west - self.size, area.south - self.size
        self.columns, self._rows = math.ceil(width / self.size) + 3, math.ceil(height / self.size) + 3
        row, column = np.divmod(np.arange(self._rows * self.columns), self.columns)
        self.x, self.y = self._west + self.size * column, self._south + self.size * row  # of all cells' middles
        self.edge: Mask = (row == 0) | (row == self._rows - 1) | (column == 0) | (column == self.columns - 1)

    def numbers(self, x: Floats, y: Floats) -> Indices:
        """Return the cells of places; of a place outside, a cell beside the edge."""
        column = np.minimum(np.maximum((x - self._west) / self.size + 0.5, 1), self.columns - 2).astype(np.intp)
        row = np.minimum(np.maximum((y - self._south) / self.size + 0.5, 1), self._rows - 2).astype(np.intp)
        return row * self.columns + column


class Field:
    """Distances to `place`, through the cells that are `free`."""

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
            steps[onto] = number  # also of cells that are not free: these are reached, and not left
            front = np.unique(onto[free[onto]])
        self._left = np.where(steps < 0, FAR, steps * (STEP * cells.size))

    def __call__(self, x: Floats, y: Floats) -> Floats:
        """Return the distances from places; FAR where the cells have no way."""
        return self._left[self._cells.numbers(x, y)]
