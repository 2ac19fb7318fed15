"""What state a simulated copter is in: booting, its mode, arming, landed or not, and the failsafes that change it.

Behaves as was observed on ArduPilot 4.7: a mode set in the first second after boot is acknowledged and lost; arming is
refused, in words, before the position estimate; it disarms 10 s after an arming that no take-off followed; GUIDED
leaves the ground by NAV_TAKEOFF only; it lands 5 s after the last heartbeat of its ground station.
"""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from targets.sim.mavlink_guided import Aim, Guidance, Vector

STABILIZE, ALT_HOLD, GUIDED, LOITER, LAND, POSHOLD, BRAKE = 0, 2, 4, 5, 9, 16, 17
MODES = (STABILIZE, ALT_HOLD, GUIDED, LOITER, LAND, POSHOLD, BRAKE)
ACCEPTED: int = mavlink.MAV_RESULT_ACCEPTED
DENIED: int = mavlink.MAV_RESULT_DENIED
FAILED: int = mavlink.MAV_RESULT_FAILED
MODE_LOST = 1.0  # seconds after boot in which a mode is acknowledged and forgotten
GCS_TIMEOUT = 5.0


class Copter:
    """Modes and arming. `said` collects STATUSTEXTs as (severity, text) for the telemetry to send."""

    def __init__(self, boot: float) -> None:
        self._boot = boot
        self.started: float | None = None
        self.guidance = Guidance()
        self.params = {
            "DISARM_DELAY": 10.0, "FS_GCS_ENABLE": 5.0, "FS_GCS_TIMEOUT": 5.0, "FS_THR_ENABLE": 0.0,
            "GUID_TIMEOUT": 3.0, "LAND_REPOSITION": 0.0, "MAV_GCS_SYSID": 255.0, "MAV_SYSID": 1.0,
            "WPNAV_SPEED": 500.0,
        }  # fmt: skip
        self.said: list[tuple[int, str]] = []
        self.mode = STABILIZE
        self.armed = False
        self.landed = True
        self.home: Vector = (0.0, 0.0, 0.0)
        self.failing_check = ""  # what a pre-arm check complains about, when one does
        self.ground_station: float | None = None  # when its last heartbeat came
        self._armed_at = 0.0
        self._still: float | None = None

    def estimating(self, now: float) -> bool:
        """Whether the boot is over and the position known."""
        return self.started is not None and now - self.started >= self._boot

    def set_mode(self, mode: int, position: Vector, now: float) -> int:
        """A MAV_RESULT."""
        if mode not in MODES:
            return DENIED
        if mode == GUIDED and not self.estimating(now):
            self.say(mavlink.MAV_SEVERITY_WARNING, "Mode change to GUIDED failed: requires position")
            return FAILED
        if self.started is None or now - self.started < self._boot + MODE_LOST:
            return ACCEPTED
        self._enter(mode, position, now)
        return ACCEPTED

    def _enter(self, mode: int, position: Vector, now: float) -> None:
        if mode == self.mode:
            return
        self.mode = mode
        self._still = None
        aim = {LAND: Aim.LAND, STABILIZE: Aim.FALL}.get(mode, Aim.HOLD)
        self.guidance.go(aim, now, position if aim is not Aim.LAND else (position[0], position[1], self.home[2]))

    def arm(self, position: Vector, yaw: float, now: float) -> int:
        """A MAV_RESULT."""
        if self.armed:
            return ACCEPTED
        fault = self.failing_check
        if not self.estimating(now):
            fault = "Need Position Estimate"
        elif self.mode == LAND:
            fault = "LAND mode not armable"
        if fault:
            self.say(mavlink.MAV_SEVERITY_CRITICAL, f"Arm: {fault}")
            return FAILED
        self.armed, self._armed_at, self.home = True, now, position
        self.guidance.stop(now, position)
        self.guidance.yaw = yaw
        self.say(mavlink.MAV_SEVERITY_INFO, "Arming motors")
        return ACCEPTED

    def disarm(self, force: bool) -> int:
        """A MAV_RESULT; in flight only by force."""
        if not self.landed and not force:
            return FAILED
        if self.armed:
            self.armed, self.landed = False, True
            self.say(mavlink.MAV_SEVERITY_INFO, "Disarming motors")
        return ACCEPTED

    def take_off(self, above_home: float, position: Vector, now: float) -> int:
        """A MAV_RESULT."""
        height = self.home[2] + above_home
        if self.mode != GUIDED or not self.armed or not self.landed or not height > position[2]:
            return FAILED
        self.landed = False
        self.guidance.go(Aim.TAKEOFF, now, (position[0], position[1], height))
        return ACCEPTED

    def watch(self, position: Vector, velocity: Vector, now: float) -> None:
        """What happens by itself: auto-disarm, touch-down, failsafe."""
        if not self.armed:
            return
        if self.landed:
            waits_for_pilot = self.mode == LAND and self.params["LAND_REPOSITION"]
            delay = 1.0 if self.mode == LAND else self.params["DISARM_DELAY"]
            if not waits_for_pilot and now - max(self._armed_at, self.guidance.since) > delay:
                self.disarm(force=False)
            return
        silent = 0.0 if self.ground_station is None else now - self.ground_station
        if silent > GCS_TIMEOUT and self.params["FS_GCS_ENABLE"] and self.mode != LAND:
            self.say(mavlink.MAV_SEVERITY_WARNING, "GCS Failsafe")
            self._enter(LAND, position, now)
        if self.mode == LAND:
            self._touch_down(velocity, now)

    def _touch_down(self, velocity: Vector, now: float) -> None:
        if now - self.guidance.since < 1.0 or abs(velocity[2]) > 0.1:
            self._still = None
            return
        self._still = now if self._still is None else self._still
        if now - self._still > 1.0:
            self.landed = True
            if not self.params["LAND_REPOSITION"]:  # else it waits for a pilot who is not there
                self.disarm(force=False)

    def say(self, severity: int, text: str) -> None:
        self.said.append((severity, text))
