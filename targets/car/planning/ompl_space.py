"""OMPL's state spaces of car poses: lengths of shortest curves, and RRT* over such curves.

This module uses only a few calls of OMPL's Python binding, and a test checks that they work in version 2.0.1, whose
out-parameters stay empty. They are the calls listed in `targets/planning/ompl_trees.py`, except those of vector spaces,
and `ReedsSheppStateSpace`, `DubinsStateSpace`, `distance`, `setXY`, `setYaw`, `getX`, `getY`, `getYaw`,
`GoalStates.addState`, `addStartState`, `setGoal`, `setRange`, `setGoalBias`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from ompl import base, geometric, util

from targets.car.base.bicycle import wrap
from targets.car.planning.curves import Triple
from targets.car.planning.planner import Area
from targets.planning.limit import STARTS, Limit

RANGE = 2.0  # metres: maximum length of a tree's edge
GOAL_BIAS = 0.2  # share of samples at the goal, in trees of a car without reverse gear


class OmplSpace:
    """Poses in an area, joined by curves with a minimum turning radius (m), in both gears if `reverse`."""

    def __init__(self, radius: float, reverse: bool, area: Area) -> None:
        util.setLogLevel(util.LogLevel.LOG_NONE)
        self._reverse = reverse
        self._space = (base.ReedsSheppStateSpace if reverse else base.DubinsStateSpace)(radius)
        self._a, self._b = self._space.allocState(), self._space.allocState()
        bounds = base.RealVectorBounds(2)
        for axis, (low, high) in enumerate(((area.west, area.east), (area.south, area.north))):
            bounds.setLow(axis, low)
            bounds.setHigh(axis, high)
        self._space.setBounds(bounds)

    def distance(self, a: Triple, b: Triple) -> float:
        """Return the length (m) of the shortest curve from one pose to another."""
        return float(self._space.distance(_put(self._a, a), _put(self._b, b)))

    def grown(
        self, start: Triple, goals: Sequence[Triple], clear: Callable[[Triple, Triple, float], bool], over: Limit,
        seed: int | None,
    ) -> list[Triple] | None:  # fmt: skip
        """Return the poses after the start on the path that RRT* finds; None if it finds none.

        `clear` returns whether the shortest curve between two poses, whose length (m) it receives, is clear."""
        if seed is not None:
            util.RNG.setSeed(seed * STARTS + 1)
        information = base.SpaceInformation(self._space)
        information.setStateValidityChecker(lambda state: True)  # the check of a curve covers its ends
        validator = _Curves(information, self._space, clear)
        information.setMotionValidator(validator)
        information.setup()
        problem = base.ProblemDefinition(information)
        problem.addStartState(_put(self._space.allocState(), start))
        ends = base.GoalStates(information)
        for goal in goals:
            ends.addState(_put(self._space.allocState(), goal))
        problem.setGoal(ends)
        planner = geometric.RRTstar(information)
        planner.setRange(RANGE)
        if not self._reverse:
            planner.setGoalBias(GOAL_BIAS)
        planner.setProblemDefinition(problem)
        planner.setup()
        planner.solve(base.PlannerTerminationCondition(over))
        if not problem.hasExactSolution():
            return None
        found = problem.getSolutionPath()
        return [_pose(found.getState(i)) for i in range(1, found.getStateCount())]


class _Curves(base.MotionValidator):  # type: ignore[misc]
    def __init__(self, information: Any, space: Any, clear: Callable[[Triple, Triple, float], bool]) -> None:
        super().__init__(information)
        self._space, self._clear = space, clear

    def checkMotion(self, a: Any, b: Any) -> bool:  # name required by OMPL
        return self._clear(_pose(a), _pose(b), float(self._space.distance(a, b)))


def _pose(state: Any) -> Triple:
    return state.getX(), state.getY(), state.getYaw()


def _put(state: Any, pose: Triple) -> Any:
    state.setXY(pose[0], pose[1])
    state.setYaw(wrap(pose[2]))
    return state
