"""Where the vehicle is to be: the program's target or path, the pause, the waiting place; heading; `reached`."""

from __future__ import annotations

import math

from koordgen.runtime.config.settings import Box
from koordgen.runtime.values.geodesy import LocalFrame
from koordgen.runtime.values.points import Point, distance, transmissible
from koordgen.runtime.vehicle.platform import Unready
from koordgen.runtime.vehicle.safety import clamp
from targets.mavlink.link import Link
from targets.quad.autopilot.telemetry import Telemetry
from targets.quad.motion.reference import STANDING, Reference
from targets.quad.motion.rejoin import OpenSpace, Rejoin, Ways
from targets.quad.motion.setpoint import ARDUPILOT, Aim, Shaping, aimed, setpoint
from targets.quad.motion.trajectory import Limits, State, norm
from targets.quad.motion.yaw import Yaw

UNFOLLOWED = 5.0  # seconds for which the autopilot may show no sign of following the setpoints
SPACING = 0.04  # seconds between two setpoints at least
NEAR = 0.3  # metres by which the target that the autopilot tells may differ from what was sent
HALTING = 1.0  # seconds for which a halt is told
PLANNED = 0.97  # of the limits of speed, for the reference: the rest is room for the vehicle to catch up
SETTLED = 0.1  # m: a vehicle that is so near, and slow, stands where it is to wait
MARGIN = 0.15  # m from the fence's faces within which nothing is made for: room for the vehicle's own wavering


def room(fence: Box, height: float) -> Box:
    """What may be made for: the fence without MARGIN at its sides and above, from the flight height upwards. A fence
    too narrow for the margin keeps the middle half."""
    lo, hi = clamp(fence, Point(-math.inf, -math.inf, -math.inf)), clamp(fence, Point(math.inf, math.inf, math.inf))
    x, y = (min(MARGIN, side / 4) for side in (hi.x - lo.x, hi.y - lo.y))
    return Box(Point(lo.x + x, lo.y + y, height), Point(hi.x - x, hi.y - y, max(height, hi.z - MARGIN)))


class Motion:
    """Lengths in m, fleet's ENU. Heights are raised to `height`, and everything is brought inside the fence, by a
    margin. `max_speed` and `climb` (vertical) are limits of the vehicle's own speed, m/s; `yaw` is `yaw.heading`'s,
    `action` is `Standstill`'s."""

    def __init__(
        self, frame: LocalFrame, fence: Box, height: float, max_speed: float, acceleration: float, climb: float,
        radius: float, dwell: float, yaw: str | float = "keep", shaping: Shaping = ARDUPILOT,
        ways: Ways | None = None, action: str = "hold",
    ) -> None:  # fmt: skip
        self._frame, self._fence = frame, fence
        self._radius, self._dwell, self._speed = radius, dwell, max_speed
        self._room = room(fence, height)
        self._limits = Limits(max_speed, climb, acceleration, self._room)
        self._reference = Reference(Limits(PLANNED * max_speed, PLANNED * climb, acceleration, self._room))
        self._rejoin = Rejoin(self._reference, OpenSpace() if ways is None else ways, action)
        self._shaping = shaping
        self._yaw = Yaw(yaw)
        self._commanded: tuple[Point, ...] = ()
        self._goal: Point | None = None  # what `reached` is about
        self._near: float | None = None  # since when the vehicle stands at the goal
        self._sent: float | None = None  # when the last setpoint was sent
        self._doubted: float | None = None  # since when the autopilot has shown no sign of following
        self._halt: tuple[Point, float] | None = None  # goal of a stop, and until when it is sent
        self.reached = True
        self.followed = False  # whether the autopilot was seen to follow the setpoints, and still does
        self.settled = False  # whether the vehicle was seen to stand where it is to wait, since it is steered
        self.refused = 0  # targets that were not finite

    def command(self, points: tuple[Point, ...], now: float, passed: int | None = None) -> None:
        """Go there, straight from each point to the next; a target is a path of one point, none is: stay here. What
        is being followed already changes nothing. With `passed`, so many points are behind the vehicle, and nobody has
        checked the leg to the next one."""
        if not transmissible(points):
            self.refused += 1
            return
        lifted = tuple(clamp(self._room, p) for p in points)
        if lifted == self._commanded and self._goal is not None:
            return
        self._commanded, self._goal = lifted, lifted[-1] if lifted else None
        self._near, self.reached = None, not lifted
        self._reference.follow(lifted[passed or 0 :], now)
        self._rejoin.command(now, unchecked=passed is not None)

    def hold(self, on: bool, now: float) -> None:
        """Pause where the vehicle can stop, or resume."""
        self._rejoin.hold(on, now)

    @property
    def stall(self) -> str:
        """See koordgen.runtime.vehicle.platform: why there is no way on from where the vehicle is."""
        return self._rejoin.stall

    def news(self) -> list[str]:
        """Return what happened since the last call, for the log."""
        return self._rejoin.news()

    def steer(self, link: Link, state: Telemetry, now: float) -> None:
        """Send the next setpoint when one is due, and look whether the autopilot follows the last ones. Raises
        Unready when it does not. Called while flying with a fresh position only."""
        position = state.position
        if position is None or link.vehicle is None or (self._sent is not None and now - self._sent < SPACING):
            return
        self._attend(position, state.velocity, now)
        age = 0.0 if state.time is None else now - state.time
        here = State(position + state.velocity * (age + self._shaping.delay), state.velocity)
        aim = aimed(self._reference, here, self._shaping, self._limits)
        aim = self._rejoin.bounded(aim, position, self._shaping)
        yaw = self._yaw.command(state, self._reference.at(0.0).velocity, now)
        self._say(link, Aim(aim.position, aim.velocity, yaw), now)
        self._yaw.watch(state)
        self._watch(link, state, aim, now)
        self._judge(position, state.velocity, now)

    def _attend(self, position: Point, velocity: Point, now: float) -> None:
        """Run the reference on, along legs that are clear."""
        there = self.reached or self._goal is None or distance(position, self._goal) <= self._radius
        self._rejoin.poll(position, velocity, there, now)

    def coast(self, now: float) -> None:
        """Not ours to steer, or not yet: nothing is sent, and nothing is guessed meanwhile."""
        self._drop(now)
        self._yaw.forget()

    def rise(self, state: Telemetry, now: float) -> None:
        """The take-off climbs: only the yaw is watched, which is to stay as it is. Raises Unready."""
        self._drop(now)
        if state.fresh(now):
            self._yaw.keep(state, now)
            self._yaw.watch(state)

    def _drop(self, now: float) -> None:
        self._rejoin.drop(now)
        self._halt = self._sent = self._doubted = self._near = None
        self.followed = self.settled = False

    def halt(self, link: Link, now: float) -> None:
        """Ours, but without a fresh position: a position alone, so that the autopilot does not run on with the last
        velocity; told for a second, because some may be lost. Then nothing is sent."""
        halt = self._rejoin.drop(now)
        self._yaw.pause()
        if halt is not None and self._sent is not None:
            self._halt = halt, now + HALTING
        if self._halt is None or now > self._halt[1] or link.vehicle is None:
            self._drop(now)
        elif self._sent is None or now - self._sent >= SPACING:
            self._say(link, Aim(clamp(self._room, self._halt[0]), yaw=self._yaw.commanded), now)

    def _say(self, link: Link, aim: Aim, now: float) -> None:
        if link.vehicle is not None:
            link.send(setpoint(link.vehicle, self._frame, self._fence, aim))
            self._sent = now

    def _watch(self, link: Link, state: Telemetry, aim: Aim, now: float) -> None:
        # The autopilot tells its target at 5 Hz; of a second's worth, all but one may be lost. ArduPilot tells it only
        # while it is a position alone; of one in motion, the vehicle shows by itself whether it is followed.
        near = NEAR if aim.velocity is None else NEAR + 1.2 * self._speed
        told = state.followed if now - state.followed_time < 1.0 else None
        if told is not None and distance(told, aim.position) < near:
            self._doubted, self.followed = None, True
            return
        if aim.velocity is not None:
            self._doubted = None
            return
        self._doubted = now if self._doubted is None else self._doubted
        if now - self._doubted > 1.0:
            self.followed = False
        if now - self._doubted > UNFOLLOWED and link.alive(now):
            raise Unready(
                f"the autopilot is in {state.mode_name} but does not follow position setpoints",
                "does another program command it, or is it set to take commands from another system id only?",
            )

    def _judge(self, position: Point, velocity: Point, now: float) -> None:
        """`reached`: within the radius and standing still for the dwell; from then on, until a new target comes."""
        waiting = self._reference.at(0.0)
        stands = norm(waiting.velocity) == 0.0 and norm(velocity) < STANDING
        self.settled |= stands and distance(position, waiting.position) < SETTLED
        goal = self._goal
        if self.reached or goal is None or not self._reference.final:
            return
        speed = math.hypot(velocity.x, velocity.y, velocity.z)
        if distance(position, goal) > self._radius or speed > STANDING:
            self._near = None
            return
        self._near = now if self._near is None else self._near
        self.reached = now - self._near >= self._dwell
