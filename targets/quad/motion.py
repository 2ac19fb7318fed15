"""Where the vehicle is to be: the program's target or path, the pause, the waiting place; steering; `reached`."""

from __future__ import annotations

import math

from koordgen.runtime.geodesy import LocalFrame
from koordgen.runtime.platform import Unready
from koordgen.runtime.safety import clamp
from koordgen.runtime.settings import Box
from koordgen.runtime.values import Point, distance, transmissible
from targets.planning.route import Route
from targets.quad.link import Link
from targets.quad.setpoint import Carrot, setpoint
from targets.quad.telemetry import Telemetry

STANDING = 0.25  # m/s, above what a hovering vehicle's estimate shows
UNFOLLOWED = 5.0  # seconds for which the autopilot may show no sign of following the setpoints
SPACING = 0.04  # seconds between two setpoints at least


class Motion:
    """Lengths in m, fleet's ENU. Heights are raised to `height`, and everything is brought inside the fence."""

    def __init__(
        self, frame: LocalFrame, fence: Box, height: float, max_speed: float, radius: float, dwell: float
    ) -> None:
        self._frame, self._fence, self._height = frame, fence, height
        self._radius, self._dwell, self._speed = radius, dwell, max_speed
        self._carrot = Carrot(max_speed)
        self._route = Route()  # what was commanded last
        self._station: Point | None = None  # where to be while nothing was commanded
        self._pause: Point | None = None  # where to be while holding
        self._holding = False
        self._near: float | None = None  # since when the vehicle stands at the goal
        self._sent: float | None = None  # when the last setpoint was sent
        self._doubted: float | None = None  # since when the autopilot has shown no sign of following
        self.reached = True
        self.followed = False  # whether the autopilot was seen to follow the setpoints, and still does
        self.refused = 0  # targets that were not finite

    def command(self, points: tuple[Point, ...]) -> None:
        """Go there, straight from each point to the next; a target is a path of one point, none is: stay here. What
        is being followed already changes nothing."""
        if not transmissible(points):
            self.refused += 1
            return
        if self._route.take(tuple(map(self._lifted, points))):
            self._near, self.reached = None, not points
            if not points:
                self._station = None

    def hold(self, on: bool) -> None:
        """Pause where the vehicle is then, or resume."""
        if on != self._holding:
            self._holding, self._pause = on, None

    def _lifted(self, p: Point) -> Point:
        return clamp(self._fence, Point(p.x, p.y, max(p.z, self._height)))

    def steer(self, link: Link, state: Telemetry, now: float) -> None:
        """Send the next setpoint when one is due, and look whether the autopilot follows the last ones. Raises
        Unready when it does not. Called while flying with a fresh position only."""
        position = state.position
        if position is None or link.vehicle is None or (self._sent is not None and now - self._sent < SPACING):
            return
        if self._station is None:
            self._station = self._lifted(position)
        if self._holding and self._pause is None:
            self._pause = self._lifted(position)
            self._carrot.drop()  # it ran ahead of the vehicle: to walk it back would take as long as the way did
        seconds = SPACING if self._sent is None else now - self._sent
        goal = self._pause or self._route.goal or self._station
        carrot = self._carrot.step(goal, position, seconds)
        if carrot == self._route.goal and self._pause is None:
            self._route.passed()
        link.send(setpoint(link.vehicle, self._frame, self._fence, carrot))
        self._sent = now
        self._watch(link, state, carrot, now)
        self._judge(position, state.velocity, now)

    def coast(self) -> None:
        """Nothing is sent: the autopilot keeps the last position by itself. Nothing is guessed meanwhile."""
        self._sent = self._doubted = self._near = None
        self.followed = False

    def _watch(self, link: Link, state: Telemetry, carrot: Point, now: float) -> None:
        # The autopilot tells its target at 5 Hz; of a second's worth, all but one may be lost.
        near = 0.2 + 1.2 * self._speed
        if state.followed is not None and now - state.followed_time < 1.0 and distance(state.followed, carrot) < near:
            self._doubted, self.followed = None, True
            return
        self._doubted = now if self._doubted is None else self._doubted
        if now - self._doubted > 1.0:
            self.followed = False
        if now - self._doubted > UNFOLLOWED and link.alive(now):
            raise Unready(
                "the autopilot is in GUIDED but does not follow position setpoints",
                "does another program command it, or is it set to take commands from another system id only?",
            )

    def _judge(self, position: Point, velocity: Point, now: float) -> None:
        """`reached`: within the radius and standing still for the dwell; from then on, until a new target comes."""
        goal = self._route.goal
        if self.reached or goal is None or not self._route.last:
            return
        speed = math.hypot(velocity.x, velocity.y, velocity.z)
        if distance(position, goal) > self._radius or speed > STANDING:
            self._near = None
            return
        self._near = now if self._near is None else self._near
        self.reached = now - self._near >= self._dwell
