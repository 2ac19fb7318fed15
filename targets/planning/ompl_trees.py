"""RRT-Connect and RRT* of OMPL: trees of straight edges in a box.

OMPL samples and grows the trees. The exact test of `room.py` decides whether an edge is clear, so edges need no padding
and are not checked in steps.

In OMPL's Python binding 2.0.1, out-parameters stay empty. So only these calls are used, and a test checks that they
work: `RealVectorStateSpace`, `RealVectorBounds.setLow/setHigh`,
`setBounds`, `allocState`, states' `[i]`, `SpaceInformation` with `setStateValidityChecker`, `setMotionValidator` and
`setup`, `MotionValidator` as a base class, `ProblemDefinition.setStartAndGoalStates/hasExactSolution/getSolutionPath`,
`RRTConnect`, `RRTstar`, `setProblemDefinition`, `setup`, `solve`, `PlannerTerminationCondition` of a callable,
`getStateCount`, `getState`, `RNG.setSeed`, `setLogLevel`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ompl import base, geometric, util

from koordgen.runtime.values.points import Point
from targets.planning.limit import STARTS, Limit
from targets.planning.room import Room


class OmplTrees:
    """Tree searches of OMPL in the box from `low` to `high`; if `flat`, in the plane z = low.z."""

    def __init__(self, low: Point, high: Point, flat: bool, seed: int | None) -> None:
        util.setLogLevel(util.LogLevel.LOG_NONE)
        self._low, self._flat, self._seed = low, flat, seed
        self._axes = "xy" if flat else "xyz"
        self._space = base.RealVectorStateSpace(len(self._axes))
        bounds = base.RealVectorBounds(len(self._axes))
        for number, axis in enumerate(self._axes):
            bounds.setLow(number, getattr(low, axis))
            bounds.setHigh(number, getattr(high, axis))
        self._space.setBounds(bounds)

    def connect(self, here: Room, start: Point, goal: Point, over: Limit, turn: int) -> list[Point] | None:
        """Return the corners of a path that RRT-Connect finds; None if the limit ends the search first."""
        return self._search(geometric.RRTConnect, here, start, goal, over, turn)

    def improve(self, here: Room, start: Point, goal: Point, over: Limit) -> list[Point] | None:
        """Return the corners of a path that RRT* finds; None if it finds no path.

        RRT* improves its tree until the limit ends the search."""
        return self._search(geometric.RRTstar, here, start, goal, over, 0)

    def _search(self, kind: Any, here: Room, start: Point, goal: Point, over: Limit, turn: int) -> list[Point] | None:
        if self._seed is not None:
            util.RNG.setSeed(self._seed * STARTS + turn + 1)
        information = base.SpaceInformation(self._space)
        information.setStateValidityChecker(lambda state: True)  # the check of an edge includes the ends of the edge
        validator = _Lines(information, here, self._point)
        information.setMotionValidator(validator)
        information.setup()
        problem = base.ProblemDefinition(information)
        problem.setStartAndGoalStates(self._state(start), self._state(goal))
        planner = kind(information)
        planner.setProblemDefinition(problem)
        planner.setup()
        planner.solve(base.PlannerTerminationCondition(over))
        if not problem.hasExactSolution():
            return None
        found = problem.getSolutionPath()
        return [self._point(found.getState(i)) for i in range(1, found.getStateCount() - 1)]

    def _point(self, state: Any) -> Point:
        return Point(state[0], state[1], self._low.z if self._flat else state[2])

    def _state(self, p: Point) -> Any:
        state = self._space.allocState()
        for number, axis in enumerate(self._axes):
            state[number] = getattr(p, axis)
        return state


class _Lines(base.MotionValidator):  # type: ignore[misc]
    def __init__(self, information: Any, here: Room, point: Callable[[Any], Point]) -> None:
        super().__init__(information)
        self._here, self._point = here, point

    def checkMotion(self, a: Any, b: Any) -> bool:  # the name that OMPL calls
        return self._here.clear(self._point(a), self._point(b))
