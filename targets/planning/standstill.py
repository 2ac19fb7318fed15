"""Detection of a vehicle that should move but stands, for example pressed against an obstacle."""

from __future__ import annotations

import math

from koordgen.runtime.values.points import Point, distance
from koordgen.runtime.vehicle.platform import Unready

# Seconds without motion after which a vehicle counts as standing still. The time is longer than
# `targets.quad.motion.motion.UNFOLLOWED`, so that an autopilot that ignores setpoints is reported first.
NO_PROGRESS = 8.0
MOVED = 0.1  # m; a larger displacement counts as motion
SAME_PLACE = 0.3  # m; two standstills that are at most this distance apart count as being at the same place


class Standstill:
    """Standstill detector of one vehicle.

    `action`: reaction to a standstill, the setting `missed_action` of the fleet file.
    "stop": the vehicle makes its safe stop.
    "hold": the vehicle brakes, and another path is planned. At the second standstill at the same place, the vehicle
    holds until the next command; `holding` gives the reason."""

    def __init__(self, action: str) -> None:
        self._action = action
        self._moved: tuple[Point, float] | None = None  # place and time of the last motion or command
        self._last: Point | None = None  # place of the last standstill
        self._log_lines: list[str] = []
        self.holding = ""

    def command(self) -> None:
        """Forget all standstills, because the vehicle has a new command."""
        self._moved = self._last = None
        self.holding = ""

    def look(self, position: Point, moves: bool, goal: str, now: float) -> bool:
        """Return whether the vehicle must brake. Raises Unready if the vehicle must make its safe stop.

        `moves`: whether the vehicle is commanded to move. `goal`: the vehicle's goal in words."""
        if not moves or self._moved is None or distance(position, self._moved[0]) > MOVED:
            self._moved = position, now
            return False
        if now - self._moved[1] <= NO_PROGRESS:
            return False
        again = self._last is not None and distance(position, self._last) <= SAME_PLACE
        self._last, self._moved = position, None
        place = f"({position.x:.2f}, {position.y:.2f}, {position.z:.2f})"
        line = f"no progress for {NO_PROGRESS:g} s at {place} on the way to {goal}"
        if self._action == "stop":
            raise Unready(line, "check what blocks the vehicle, which stops because missed_action is stop")
        if not again:
            self._log_lines.append(f"{line}: braking, and looking for another path")
        else:
            self.holding = f"{line}, twice: holding until the next command"
            self._log_lines.append(self.holding)
        return True

    def log_lines(self) -> list[str]:
        """Return log lines on standstills since the last call."""
        said, self._log_lines = self._log_lines, []
        return said


# Failed planner calls of the program. They explain why a robot without any other command stands still.

FORGOTTEN = 5.0  # seconds after which a failed call of the planner no longer counts as the reason for standing

# Failed calls with these reasons are no stall. In a mixed fleet, each robot's program may ask for a path to every task.
# A car leaves the tasks in the air to quads, and a quad leaves the tasks on the ground to cars.
ANOTHERS = ("the goal is not on the ground", "the goal is not above the ground")


class Unplanned:
    """Record of the program's last call of the planner, if this call found no path.

    Times are in seconds on the platform's clock."""

    def __init__(self) -> None:
        self._why, self._at = "", -math.inf

    def called(self, goal: Point, reason: str, now: float) -> None:
        """Record a call of the planner for a path to `goal`.

        `reason`: why the planner found no path; "" if it found a path."""
        found = not reason or reason in ANOTHERS
        self._why, self._at = "" if found else f"the planner's goal {_placed(goal)} {reason}", now

    def commanded(self) -> None:
        """Record that the program commanded a target or a path."""
        self._why = ""

    def why(self, now: float) -> str:
        """Return the reason why the robot has no path; "" if it has a path, or no longer asks for a path."""
        return self._why if now - self._at <= FORGOTTEN else ""


def _placed(p: Point) -> str:
    return f"({p.x:.2f}, {p.y:.2f}, {p.z:.2f})"
