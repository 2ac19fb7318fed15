"""No progress: a vehicle that should move and stays where it is, pressed against an obstacle for example."""

from __future__ import annotations

import math

from koordgen.runtime.values.points import Point, distance
from koordgen.runtime.vehicle.platform import Unready

# Seconds without motion after which a vehicle counts as standing still: longer than an autopilot may seem not to follow
# setpoints (`targets.quad.motion.motion.UNFOLLOWED`), which has a message of its own.
NO_PROGRESS = 8.0
MOVED = 0.1  # m that count as motion
SAME_PLACE = 0.3  # m from where a vehicle stood still within which the next time is in the same place


class Standstill:
    """Watches one vehicle, which takes the fleet file's `missed_action` when it stands still: with "rest" it comes to
    rest for good. With "hold" it brakes and looks for another way; a second time in the same place it holds until the
    next command, and `holding` says why."""

    def __init__(self, action: str) -> None:
        self._action = action
        self._moved: tuple[Point, float] | None = None  # where and when the vehicle moved last, or had no reason to
        self._last: Point | None = None  # where it stood still last
        self._news: list[str] = []
        self.holding = ""

    def command(self) -> None:
        """Begin anew: the vehicle has a new command."""
        self._moved = self._last = None
        self.holding = ""

    def look(self, position: Point, moves: bool, goal: str, now: float) -> bool:
        """Return whether the vehicle must brake; `moves` says that it is commanded to move, `goal` where to. Raises
        Unready where it is to come to rest."""
        if not moves or self._moved is None or distance(position, self._moved[0]) > MOVED:
            self._moved = position, now
            return False
        if now - self._moved[1] <= NO_PROGRESS:
            return False
        again = self._last is not None and distance(position, self._last) <= SAME_PLACE
        self._last, self._moved = position, None
        place = f"({position.x:.2f}, {position.y:.2f}, {position.z:.2f})"
        line = f"no progress for {NO_PROGRESS:g} s at {place} on the way to {goal}"
        if self._action == "rest":
            raise Unready(line, "see what blocks it; it comes to rest because missed_action is rest")
        if not again:
            self._news.append(f"{line}: braking, and looking for another way")
        else:
            self.holding = f"{line}, twice: holding until the next command"
            self._news.append(self.holding)
        return True

    def news(self) -> list[str]:
        """Return what happened since the last call, for the log."""
        said, self._news = self._news, []
        return said


# Calls of the program's planner that found no way: a robot that has nothing else to do stands because of them.

FORGOTTEN = 5.0  # seconds after which a call no longer says what the program wants
# Vehicles on the ground and in the air share their tasks by asking for all of them: these answers are no stall.
ANOTHERS = ("the goal is not on the ground", "the goal is not above the ground")


class Unplanned:
    """Times in seconds on the platform's clock."""

    def __init__(self) -> None:
        self._why, self._at = "", -math.inf

    def called(self, goal: Point, reason: str, now: float) -> None:
        """Record a call of the planner for a way to `goal`; `reason` is empty when it found one."""
        found = not reason or reason in ANOTHERS
        self._why, self._at = "" if found else f"the planner's goal {_placed(goal)} {reason}", now

    def commanded(self) -> None:
        """Record that the program commanded a target or a path."""
        self._why = ""

    def why(self, now: float) -> str:
        """Return the reason why the robot has no way; "" when it has one, or no longer asks."""
        return self._why if now - self._at <= FORGOTTEN else ""


def _placed(p: Point) -> str:
    return f"({p.x:.2f}, {p.y:.2f}, {p.z:.2f})"
