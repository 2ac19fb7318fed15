"""The yaw that is commanded, and the watch over the yaw that the vehicle has.

The commanded yaw turns no faster than TURN, which an autopilot can follow, so a vehicle whose yaw stays away from it is
not obeying. Yaws are in radians from east, counter-clockwise; rates in rad/s.
"""

from __future__ import annotations

import math

from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.platform import Unready
from targets.quad.autopilot.ardupilot import ARDUPILOT
from targets.quad.autopilot.telemetry import Telemetry

TURN = 0.6  # rad/s: the commanded yaw turns no faster
OFF, OFF_FOR = 0.6, 2.0  # rad and s: the vehicle's yaw may differ by so much, or by more for so long
SPIN, SPIN_FOR = 0.8, 1.0  # rad/s and s: it may turn so much faster than is commanded, or faster for so long
WINDOW = 0.2  # s over which a rate is measured
MOVING = 0.2  # m/s below which a direction of motion is no heading
LONGEST = 0.5  # s: after a longer pause the commanded yaw goes on from where it was
LOOK = "look at the compass or the heading that is fed, the motors, and the autopilot's ATC_ parameters for yaw"
RECEIVER = "an ArduPilot 4.7.0 from before the release that has no receiver needs GUID_OPTIONS 4"


def heading(text: str) -> str | float:
    """Return the setting `yaw`: "keep", "forward", or an angle in radians from east. Raises ValueError."""
    if text in ("keep", "forward"):
        return text
    angle = float(text)
    if not math.isfinite(angle):
        raise ValueError(text)
    return angle


class Yaw:
    """Commanded yaw. `policy`: see `heading`.

    `commanded` is None until the vehicle's own yaw is known, at which it begins."""

    def __init__(self, policy: str | float) -> None:
        self._policy = policy
        self.commanded: float | None = None
        self._time = 0.0  # when `commanded` was computed
        self._off: float | None = None  # since when the difference is too large
        self._spinning: float | None = None  # since when the difference changes too fast
        self._last: tuple[float, float] | None = None  # time and difference at the beginning of the window

    def forget(self) -> None:
        """Begin anew with the yaw that the vehicle has then: it may be turned by hand until then."""
        self.commanded = None
        self.pause()

    def pause(self) -> None:
        """Drop what was measured: nothing is known of the vehicle for some time."""
        self._off = self._spinning = self._last = None

    def keep(self, state: Telemetry, now: float) -> None:
        """Command the present yaw again: the vehicle climbs."""
        if self.commanded is None:
            self.commanded = state.yaw
        self._time = now

    def command(self, state: Telemetry, velocity: Point, now: float) -> float | None:
        """Return the yaw to send for a reference of this velocity (m/s). Without one ArduPilot turns to wherever it
        flies (WP_YAW_BEHAVIOR)."""
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
        """Compare the vehicle's yaw with the commanded one. Raises Unready when it does not obey."""
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
                f"the vehicle turns by itself, {abs(rate):.1f} rad/s more than is commanded, more than {SPIN:g} rad/s "
                f"for {SPIN_FOR:g} s",
                hint,
            )
