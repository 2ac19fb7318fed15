"""Motion control: follows the program's target or path, pauses, and detects that the goal is reached.

It advances the reference trajectory, sends setpoints with yaw, and checks that the autopilot follows the setpoints.
"""

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
from targets.quad.motion.rejoin import FreeSpace, OpenSpace, Rejoin
from targets.quad.motion.setpoint import ARDUPILOT, Aim, Shaping, aimed, setpoint
from targets.quad.motion.trajectory import MotionLimits, MotionState, norm
from targets.quad.motion.yaw import Yaw

UNFOLLOWED = 5.0  # seconds without evidence that the autopilot follows setpoints, after which `steer` raises Unready
SPACING = 0.04  # minimum seconds between two setpoints
NEAR = 0.3  # metres by which the setpoint that the autopilot reports may differ from the sent setpoint
HALTING = 1.0  # seconds for which the setpoint of a halt is repeated
PLANNED = 0.97  # share of the speed limits that the reference uses, so that a faster vehicle can catch up
SETTLED = 0.1  # m; a slow vehicle within this distance of a standing reference counts as settled
MARGIN = 0.15  # m that setpoints keep from the geofence's faces, because the vehicle wavers around its setpoints


def room(fence: Box, height: float) -> Box:
    """Return the box for targets and setpoints: the geofence, less MARGIN at its sides and its top.

    The bottom of the box is the flight height `height`. Where the fence is too narrow for the margin, the box is the
    middle half of its width."""
    lo, hi = clamp(fence, Point(-math.inf, -math.inf, -math.inf)), clamp(fence, Point(math.inf, math.inf, math.inf))
    x, y = (min(MARGIN, side / 4) for side in (hi.x - lo.x, hi.y - lo.y))
    return Box(Point(lo.x + x, lo.y + y, height), Point(hi.x - x, hi.y - y, max(height, hi.z - MARGIN)))


class Motion:
    """Motion control of one vehicle. Lengths in metres, in the fleet's ENU frame.

    `height`: minimum flight height; lower targets are raised to it. All targets are clamped into `room`.
    `max_speed`, `climb`: limits of the vehicle's speed and of its vertical speed, m/s.
    `acceleration`: limit of the reference's acceleration, m/s^2.
    `radius`, `dwell`: the goal is reached after `dwell` seconds of standing within `radius` of it.
    `yaw`: result of `yaw.heading`. `shaping`: the autopilot's response to setpoints. `space`: obstacles and planner.
    `action`: reaction to a standstill, as in `Standstill`.
    """

    def __init__(
        self, frame: LocalFrame, fence: Box, height: float, max_speed: float, acceleration: float, climb: float,
        radius: float, dwell: float, yaw: str | float = "keep", shaping: Shaping = ARDUPILOT,
        space: FreeSpace | None = None, action: str = "hold",
    ) -> None:  # fmt: skip
        self._frame, self._fence = frame, fence
        self._radius, self._dwell, self._speed = radius, dwell, max_speed
        self._room = room(fence, height)
        self._limits = MotionLimits(max_speed, climb, acceleration, self._room)
        self._reference = Reference(MotionLimits(PLANNED * max_speed, PLANNED * climb, acceleration, self._room))
        self._rejoin = Rejoin(self._reference, OpenSpace() if space is None else space, action)
        self._shaping = shaping
        self._yaw = Yaw(yaw)
        self._commanded: tuple[Point, ...] = ()
        self._goal: Point | None = None  # last point of the command, to which `reached` refers
        self._near: float | None = None  # time since which the vehicle stands at the goal
        self._sent: float | None = None  # time at which the last setpoint was sent
        self._unconfirmed: float | None = (
            None  # time since which no evidence shows that the autopilot follows setpoints
        )
        self._halt: tuple[Point, float] | None = None  # place of a halt, and time until which its setpoint is sent
        self.reached = True  # whether the goal is reached; True without a goal
        self.followed = False  # whether there is evidence that the autopilot follows the setpoints
        self.settled = False  # True after the vehicle stood still at a standing reference, since steering began
        self.refused = 0  # number of commands refused because a point was not finite

    def command(self, points: tuple[Point, ...], now: float, passed: int | None = None) -> None:
        """Fly along these points, in a straight line from each to the next.

        A target is a path of one point. Without points, stop. A command that is followed already has no effect. If
        `passed` is given, the vehicle has passed that many points, and the leg to the next point was not checked."""
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
        """Brake and hold the position, or resume."""
        self._rejoin.hold(on, now)

    @property
    def stall(self) -> str:
        """Reason why the vehicle has no path to its goal, in words; "" if it has a path."""
        return self._rejoin.stall

    def log_lines(self) -> list[str]:
        """Return log lines on standstills since the last call."""
        return self._rejoin.log_lines()

    def steer(self, link: Link, state: Telemetry, now: float) -> None:
        """Send the next setpoint if one is due, and check that the autopilot follows the setpoints.

        Raises Unready if the autopilot does not follow them. Call this only in flight and with a fresh position."""
        position = state.position
        if position is None or link.vehicle is None or (self._sent is not None and now - self._sent < SPACING):
            return
        self._attend(position, state.velocity, now)
        age = 0.0 if state.time is None else now - state.time
        here = MotionState(position + state.velocity * (age + self._shaping.delay), state.velocity)
        aim = aimed(self._reference, here, self._shaping, self._limits)
        aim = self._rejoin.bounded(aim, position, self._shaping)
        yaw = self._yaw.command(state, self._reference.at(0.0).velocity, now)
        self._send_setpoint(link, Aim(aim.position, aim.velocity, yaw), now)
        self._yaw.watch(state)
        self._watch(link, state, aim, now)
        self._judge(position, state.velocity, now)

    def _attend(self, position: Point, velocity: Point, now: float) -> None:
        """Advance the reference to `now`, along legs that are clear of obstacles."""
        there = self.reached or self._goal is None or distance(position, self._goal) <= self._radius
        self._rejoin.poll(position, velocity, there, now)

    def coast(self, now: float) -> None:
        """Send nothing, and drop the reference's trajectory.

        This is for a vehicle that does not fly, or that a pilot or a failsafe controls."""
        self._drop(now)
        self._yaw.forget()

    def rise(self, state: Telemetry, now: float) -> None:
        """Check that the yaw stays constant during the take-off climb. Raises Unready if it changes."""
        self._drop(now)
        if state.fresh(now):
            self._yaw.keep(state, now)
            self._yaw.watch(state)

    def _drop(self, now: float) -> None:
        self._rejoin.drop(now)
        self._halt = self._sent = self._unconfirmed = self._near = None
        self.followed = self.settled = False

    def halt(self, link: Link, now: float) -> None:
        """Halt a vehicle in flight whose position is not fresh.

        Sends a setpoint with a position only, so that the autopilot does not go on with the last velocity. The setpoint
        is repeated for HALTING seconds, because messages may be lost. After that, nothing is sent."""
        halt = self._rejoin.drop(now)
        self._yaw.pause()
        if halt is not None and self._sent is not None:
            self._halt = halt, now + HALTING
        if self._halt is None or now > self._halt[1] or link.vehicle is None:
            self._drop(now)
        elif self._sent is None or now - self._sent >= SPACING:
            self._send_setpoint(link, Aim(clamp(self._room, self._halt[0]), yaw=self._yaw.commanded), now)

    def _send_setpoint(self, link: Link, aim: Aim, now: float) -> None:
        if link.vehicle is not None:
            link.send(setpoint(link.vehicle, self._frame, self._fence, aim))
            self._sent = now

    def _watch(self, link: Link, state: Telemetry, aim: Aim, now: float) -> None:
        # The autopilot reports its setpoint at 5 Hz, and one report per second is enough. ArduPilot reports only
        # setpoints without a velocity. For the other setpoints, only the vehicle's motion shows whether ArduPilot
        # follows them.
        near = NEAR if aim.velocity is None else NEAR + 1.2 * self._speed
        told = state.followed if now - state.followed_time < 1.0 else None
        if told is not None and distance(told, aim.position) < near:
            self._unconfirmed, self.followed = None, True
            return
        if aim.velocity is not None:
            self._unconfirmed = None
            return
        self._unconfirmed = now if self._unconfirmed is None else self._unconfirmed
        if now - self._unconfirmed > 1.0:
            self.followed = False
        if now - self._unconfirmed > UNFOLLOWED and link.alive(now):
            raise Unready(
                f"the autopilot is in {state.mode_name} but does not follow position setpoints",
                "check whether another program commands the autopilot, or it accepts another MAVLink system id only",
            )

    def _judge(self, position: Point, velocity: Point, now: float) -> None:
        """Update `settled` and `reached`.

        The goal is reached once the vehicle has stood within the radius for the dwell time. The goal then stays reached
        until the next command."""
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
