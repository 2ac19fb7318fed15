"""Yaw control: computes the commanded yaw, and checks that the vehicle's yaw follows it.

The commanded yaw turns at the rate TURN at most, which an autopilot can follow. So a lasting difference between the
vehicle's yaw and the commanded yaw means that the vehicle does not obey. Yaws are in radians from east,
counter-clockwise; rates in rad/s.
"""

from __future__ import annotations

import math

from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.platform import Unready
from targets.quad.autopilot.ardupilot import ARDUPILOT
from targets.quad.autopilot.telemetry import Telemetry

TURN = 0.6  # rad/s, maximum rate of the commanded yaw
OFF, OFF_FOR = 0.6, 2.0  # rad, s: an error of the vehicle's yaw above OFF that lasts longer than OFF_FOR is a failure
SPIN, SPIN_FOR = 0.8, 1.0  # rad/s, s: a yaw error that changes faster than SPIN for longer than SPIN_FOR is a failure
WINDOW = 0.2  # s over which the rate of change of the yaw error is measured
MOVING = 0.2  # m/s; with policy "forward", the yaw follows the direction of motion above this horizontal speed
LONGEST = 0.5  # s; a longer time between two steps counts as this time
LOOK = "check the compass or the position feed's heading, the motors, and the autopilot's ATC_ parameters for yaw"
RECEIVER = "a pre-release build of ArduPilot 4.7.0 without a radio receiver needs GUID_OPTIONS 4"


def heading(text: str) -> str | float:
    """Return the setting `yaw`: "keep", "forward", or an angle in radians from east. Raises ValueError."""
    if text in ("keep", "forward"):
        return text
    angle = float(text)
    if not math.isfinite(angle):
        raise ValueError(text)
    return angle


class Yaw:
    """Yaw control of one vehicle. `policy`: result of `heading`.

    `commanded`: the commanded yaw (rad). It starts with the vehicle's yaw, and is None until that yaw is known."""

    def __init__(self, policy: str | float) -> None:
        self._policy = policy
        self.commanded: float | None = None
        self._time = 0.0  # time at which the commanded yaw was computed last
        self._off: float | None = None  # time since which the yaw error is above OFF
        self._spinning: float | None = None  # time since which the yaw error changes faster than SPIN
        self._last: tuple[float, float] | None = None  # time and yaw error at the beginning of the WINDOW

    def forget(self) -> None:
        """Forget the commanded yaw, so that the next command starts with the vehicle's yaw.

        A person may turn the vehicle by hand."""
        self.commanded = None
        self.pause()

    def pause(self) -> None:
        """Drop the measurements of `watch`, because no telemetry will arrive for some time."""
        self._off = self._spinning = self._last = None

    def keep(self, state: Telemetry, now: float) -> None:
        """Keep the commanded yaw during the take-off climb. The first commanded yaw is the vehicle's yaw."""
        if self.commanded is None:
            self.commanded = state.yaw
        self._time = now

    def command(self, state: Telemetry, velocity: Point, now: float) -> float | None:
        """Return the yaw to send with the next setpoint; None if the vehicle's yaw is unknown.

        `velocity`: velocity of the reference (m/s). A yaw is sent with every setpoint, because otherwise ArduPilot
        turns the vehicle to the direction of flight (WP_YAW_BEHAVIOR)."""
        seconds = min(now - self._time, LONGEST)
        self.keep(state, now)
        if self.commanded is None:
            return None
        wanted = self.commanded
        if isinstance(self._policy, float):
            wanted = self._policy
        elif self._policy == "forward" and math.hypot(velocity.x, velocity.y) > MOVING:
            wanted = math.atan2(velocity.y, velocity.x)
        turn = math.remainder(wanted - self.commanded, math.tau)
        most = TURN * seconds
        self.commanded = math.remainder(self.commanded + max(-most, min(turn, most)), math.tau)
        return self.commanded

    def watch(self, state: Telemetry) -> None:
        """Compare the vehicle's yaw with the commanded yaw. Raises Unready if the vehicle does not obey."""
        if self.commanded is None or state.time is None:
            return
        now = state.time
        off = math.pi if state.yaw is None else math.remainder(state.yaw - self.commanded, math.tau)
        self._off = None if abs(off) <= OFF else now if self._off is None else self._off
        if self._off is not None and now - self._off > OFF_FOR:
            told = "not reported" if state.yaw is None else f"{abs(off):.1f} rad from what is commanded"
            raise Unready(f"the yaw is {told}, and was not within {OFF:g} rad for {OFF_FOR:g} s", LOOK)
        if self._last is None or now - self._last[0] > LONGEST:
            self._last = now, off
        since, before = self._last
        if now - since < WINDOW:
            return
        rate = math.remainder(off - before, math.tau) / (now - since)
        self._last = now, off
        self._spinning = None if abs(rate) <= SPIN else since if self._spinning is None else self._spinning
        if self._spinning is not None and now - self._spinning > SPIN_FOR:
            hint = f"{RECEIVER}; else {LOOK}" if state.firmware is ARDUPILOT else LOOK
            raise Unready(
                f"the vehicle turns by itself: its yaw rate is {abs(rate):.1f} rad/s off the commanded rate, "
                f"and was more than {SPIN:g} rad/s off for {SPIN_FOR:g} s",
                hint,
            )
