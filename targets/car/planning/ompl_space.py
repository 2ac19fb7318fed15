"""OMPL's spaces of car poses: the lengths of curves, and RRT* over them.

Of OMPL's Python binding only these calls are relied on (version 2.0.1, where out-parameters stay empty; a test holds
that they work): those listed in `targets/planning/ompl_trees.py` but those of vector spaces, and
`ReedsSheppStateSpace`, `DubinsStateSpace`, `distance`, `setXY`, `setYaw`, `getX`, `getY`, `getYaw`,
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

RANGE = 2.0  # metres: the longest edge of a tree
GOAL_BIAS = 0.2  # of the samples of a forward tree


class OmplSpace:
    """Poses in an area, joined by curves of a least radius, in both gears if `reverse`."""

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
        """Return the length of the shortest curve (m)."""
        return float(self._space.distance(_put(self._a, a), _put(self._b, b)))

    def grown(
        self, start: Triple, goals: Sequence[Triple], clear: Callable[[Triple, Triple, float], bool], over: Limit,
        seed: int | None,
    ) -> list[Triple] | None:  # fmt: skip
        """Return the poses behind the start that RRT* finds; None without a way. `clear` says whether the curve of a
        length from one pose to another is clear."""
        if seed is not None:
            util.RNG.setSeed(seed * STARTS + 1)
        information = base.SpaceInformation(self._space)
        information.setStateValidityChecker(lambda state: True)  # the ends of every curve are looked at with the curve
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

    def checkMotion(self, a: Any, b: Any) -> bool:  # OMPL's name
        return self._clear(_pose(a), _pose(b), float(self._space.distance(a, b)))


def _pose(state: Any) -> Triple:
    return state.getX(), state.getY(), state.getYaw()


def _put(state: Any, pose: Triple) -> Any:
    state.setXY(pose[0], pose[1])
    state.setYaw(wrap(pose[2]))
    return state
