"""State machine of a simulated ArduPilot copter: flight mode, arming, landed state, failsafes.

Behaves as observed on ArduPilot 4.7:

- A mode set in the first second after boot is acknowledged and lost.
- A refused arming is explained in a STATUSTEXT.
- It disarms 10 s after an arming that no take-off followed.
- GUIDED leaves the ground by NAV_TAKEOFF only, some seconds later, for the motors spin up first.
- It lands 5 s after the last heartbeat of its ground station, and when it has lost its position. A failsafe's LAND
hovers for 4 s before it descends."""

from __future__ import annotations

import math
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from targets.sim.autopilots.mavlink_estimate import SimulatedEstimator
from targets.sim.autopilots.mavlink_guided import Guidance, GuidanceMode, Vector
from targets.sim.autopilots.mavlink_params import SimulatedParameters

STABILIZE, ALT_HOLD, GUIDED, LOITER, LAND, POSHOLD, BRAKE = 0, 2, 4, 5, 9, 16, 17
MODES = (STABILIZE, ALT_HOLD, GUIDED, LOITER, LAND, POSHOLD, BRAKE)
ACCEPTED: int = mavlink.MAV_RESULT_ACCEPTED
DENIED: int = mavlink.MAV_RESULT_DENIED
FAILED: int = mavlink.MAV_RESULT_FAILED
UNSUPPORTED: int = mavlink.MAV_RESULT_UNSUPPORTED
MODE_LOST = 1.0  # seconds after boot in which a new mode is acknowledged and forgotten
FAILSAFE_PAUSE = 4.0  # seconds for which a failsafe's LAND hovers first (LAND_WITH_DELAY_MS)
# Seconds from the take-off command to leaving the ground, as observed: the rest of ARMING_DELAY (2 s), the motors'
# spin-up (MOT_SPOOL_TIME) and the ramp of the thrust (TKOFF_SLEW_TIME).
SPOOL_UP = 3.3
RISE_TIME = 0.3  # seconds at the end of SPOOL_UP in which the copter begins to rise
IGNORE_PILOT_YAW = 4  # bit of GUID_OPTIONS
SPINNING_RELEASE = (4, 7)
COMPLAINT_INTERVAL = 30.0  # seconds between two reports of failing pre-arm checks
WARNING, CRITICAL, INFO = mavlink.MAV_SEVERITY_WARNING, mavlink.MAV_SEVERITY_CRITICAL, mavlink.MAV_SEVERITY_INFO


class Copter:
    """Flight mode and arming of a copter.

    `texts` collects STATUSTEXTs as (severity, text) for the telemetry to send."""

    autopilot: int = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    refusal = "PreArm"  # first word of a STATUSTEXT that says why arming is refused
    fragile = True  # a setpoint that is not finite aborts the autopilot's process
    resets_datum = True  # the EKF resets its height datum after an origin from outside
    odometry_frames: tuple[int, ...] = (mavlink.MAV_FRAME_LOCAL_FRD,)  # frames in which an ODOMETRY message is accepted

    def __init__(self, boot: float, params: SimulatedParameters, spool_up: float = SPOOL_UP) -> None:
        self._boot, self._spool_up = boot, spool_up
        self.params = params
        self.guidance = Guidance()
        self.estimator: SimulatedEstimator  # assigned by the autopilot device
        self.texts: list[tuple[int, str]] = []
        self.mode = STABILIZE
        self.armed = False
        self.landed = True
        self.home: Vector | None = None
        self.failing_check = ""  # complaint of a failing pre-arm check that a test has set; "" for none
        self.ground_station: float | None = None  # time of its last heartbeat
        self.volts = math.inf  # of the battery
        self._charged_at = -math.inf  # time when the voltage was last high enough
        self._armed_at = 0.0
        self._rise: tuple[float, float] | None = None  # start time and target height of a commanded take-off
        self._still: float | None = None
        self._complained: float | None = None

    @property
    def position(self) -> Vector:
        """Estimated position."""
        return self.estimator.estimate.position

    @property
    def following(self) -> bool:
        """True if setpoints are obeyed: in GUIDED and off the ground. Otherwise they are dropped silently."""
        return self.mode == GUIDED and self.armed and not self.landed

    @property
    def spins(self) -> bool:
        """True if GUIDED takes the missing receiver's yaw stick for one that is pushed to its end.

        Development builds of 4.7.0 did so with FS_THR_ENABLE = 0 (github.com/ArduPilot/ardupilot/issues/31353)."""
        params = self.params
        return (
            self.mode == GUIDED
            and params.development
            and params.release == SPINNING_RELEASE
            and not params.of("FS_THR_ENABLE")
            and not int(params.of("GUID_OPTIONS")) & IGNORE_PILOT_YAW
        )

    @property
    def shows_target(self) -> bool:
        """True if the copter reports its present setpoint."""
        return self.mode == GUIDED

    @property
    def landing(self) -> bool:
        return self.mode == LAND

    @property
    def waits_for_pilot(self) -> bool:
        """True if the copter stays armed after a landing."""
        return bool(self.params.of("LAND_REPOSITION"))

    def heard_heartbeat(self, system: int, now: float) -> None:
        """Record a heartbeat. Only those of the copter's own ground station count."""
        if system == self.params.of("MAV_GCS_SYSID"):
            self.ground_station = now

    def heard_setpoint(self, now: float) -> None:
        """Record that a setpoint arrived, valid or not. ArduPilot ignores this."""

    def refuse_setpoint(self, now: float) -> None:
        """Stop: an invalid setpoint arrived."""
        self.guidance.stop(now, self.position)

    def booted(self, now: float) -> bool:
        return self.estimator.started is not None and now - self.estimator.started >= self._boot + MODE_LOST

    def heartbeat(self) -> tuple[int, int]:
        """Return the base mode and the custom mode of HEARTBEAT."""
        flags = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
        if self.mode == GUIDED:
            flags |= mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
        if self.armed:
            flags |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        return flags, self.mode

    def command(self, message: Any, now: float) -> int | None:
        """Execute DO_SET_MODE, arming, take-off and the like.

        Return a MAV_RESULT, or None for any other command."""
        p1, p2, p7 = message.param1, message.param2, message.param7
        if not all(map(math.isfinite, (p1, p2, p7))):
            return DENIED
        match message.command:
            case mavlink.MAV_CMD_DO_SET_MODE:
                if not int(p1) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
                    return UNSUPPORTED
                return self.set_mode(int(p2), now)
            case mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
                return self.arm(now) if p1 == 1 else self.disarm(force=p2 == 21196)
            case mavlink.MAV_CMD_NAV_TAKEOFF:
                return self.take_off(p7, now)
            case mavlink.MAV_CMD_RUN_PREARM_CHECKS:
                return self.run_checks(now)
            case mavlink.MAV_CMD_NAV_LAND:
                return self.set_mode(LAND, now)
            case mavlink.MAV_CMD_DO_CHANGE_SPEED:
                return self._change_speed(int(p1), p2)
        return None

    def _change_speed(self, kind: int, speed: float) -> int:
        """Execute DO_CHANGE_SPEED: airspeed, ground speed, climb or descent, until the submode changes.

        Return a MAV_RESULT."""
        if not 0.1 <= speed <= 20:
            return DENIED
        match kind:
            case 0 | 1:
                self.guidance.speed = speed
            case 2:
                self.guidance.up = speed
            case 3:
                self.guidance.down = speed
            case _:
                return DENIED
        return ACCEPTED

    def set_mode(self, mode: int, now: float) -> int:
        """Change the flight mode on request. Return a MAV_RESULT."""
        if mode not in MODES:
            return DENIED
        if mode == GUIDED and not self.estimator.ready:
            self.report_text(WARNING, "Mode change to GUIDED failed: requires position")
            return FAILED
        if self.booted(now):
            self.enter(mode, now)
        return ACCEPTED

    def enter(self, mode: int, now: float, pause: float = 0.0) -> None:
        """Change the flight mode without a check, as a remote control or a failsafe does.

        LAND descends after `pause` (s)."""
        if mode == self.mode:
            return
        self.mode = mode
        self._still = self._rise = None
        x, y, z = self.position
        match mode:
            case _ if mode == LAND:
                self.guidance.land(now, (x, y, z if self.home is None else self.home[2]), pause)
            case _ if mode == STABILIZE:
                self.guidance.go(GuidanceMode.FALL, now, (x, y, z))
            case _:
                self.guidance.stop(now, (x, y, z))

    def fault(self, now: float) -> str:
        """Return why arming is refused; "" if it is not."""
        if self.failing_check:
            return self.failing_check
        if self.params.of("FS_THR_ENABLE"):
            return "RC not found"
        return self.estimator.fault(now)

    def arm(self, now: float) -> int:
        """Arm the motors. Return a MAV_RESULT."""
        if self.armed:
            return ACCEPTED
        fault = self.fault(now)
        if fault:
            self.report_text(CRITICAL, f"{self.refusal}: {fault}")
            return FAILED
        if self.mode == LAND:
            self.report_text(CRITICAL, "Arm: LAND mode not armable")
            return FAILED
        self.armed, self._armed_at, self.home = True, now, self.position
        guidance, of = self.guidance, self.params.of
        guidance.default_speed = of("WP_SPD")
        guidance.default_up, guidance.default_down = of("WP_SPD_UP"), of("WP_SPD_DN")
        guidance.reset_speeds()
        self.guidance.timeout = self.params.of("GUID_TIMEOUT")
        self.guidance.looks_ahead = self.params.of("WP_YAW_BEHAVIOR") != 0
        self.guidance.stop(now, self.position)
        self.guidance.turn(self.estimator.estimate.yaw, 0.0)
        self.report_text(INFO, "Arming motors")
        return ACCEPTED

    def run_checks(self, now: float) -> int:
        """Report what prevents arming, without arming. Return a MAV_RESULT."""
        if self.armed:
            return int(mavlink.MAV_RESULT_TEMPORARILY_REJECTED)
        fault = self.fault(now)
        if fault:
            self.report_text(CRITICAL, f"{self.refusal}: {fault}")
        return ACCEPTED

    def disarm(self, force: bool) -> int:
        """Disarm the motors; in flight only by force. Return a MAV_RESULT."""
        if not self.landed and not force:
            return FAILED
        if self.armed:
            self.armed, self.landed, self._rise = False, True, None
            self.report_text(INFO, "Disarming motors")
        return ACCEPTED

    def take_off(self, above_home: float, now: float) -> int:
        """Begin a take-off to a height above home (m). Return a MAV_RESULT."""
        if self.mode != GUIDED or not self.armed or not self.landed or self.home is None:
            return FAILED
        height = self.home[2] + above_home
        if not height > self.position[2]:
            return FAILED
        begins = now + max(0.0, self._spool_up - RISE_TIME) if self._rise is None else self._rise[0]
        self._rise = begins, height
        return ACCEPTED

    def _lift_off(self, now: float) -> None:
        """Rise once the motors have spun up."""
        if self._rise is not None and now >= self._rise[0]:
            x, y, _ = self.position
            self.landed = False
            self.guidance.go(GuidanceMode.TAKEOFF, now, (x, y, self._rise[1]))
            self._rise = None

    def reposition(self, place: Vector, changes_mode: bool, now: float) -> int:
        """Execute DO_REPOSITION. Return a MAV_RESULT."""
        if self.mode != GUIDED and not (changes_mode and self.set_mode(GUIDED, now) == ACCEPTED):
            return DENIED
        if not self.following:
            return FAILED
        self.guidance.go(GuidanceMode.POSITION, now, place)
        return ACCEPTED

    def watch(self, now: float) -> None:
        """Do what happens without a command: complaints, auto-disarm, touch-down, failsafes."""
        if not self.armed:
            self._complain(now)
        elif self._rise is not None:
            self._lift_off(now)
        elif self.landed:
            delay = 1.0 if self.mode == LAND else self.params.of("DISARM_DELAY")
            if (
                not (self.mode == LAND and self.waits_for_pilot)
                and now - max(self._armed_at, self.guidance.since) > delay
            ):
                self.disarm(force=False)
        elif self.mode == LAND:
            self._touch_down(now)
        else:
            self._fail_safe(now)

    def _complain(self, now: float) -> None:
        if not self.booted(now):
            return
        if self._complained is None or now - self._complained >= COMPLAINT_INTERVAL:
            self._complained = now
            fault = self.fault(now)
            if fault:
                self.report_text(CRITICAL, f"{self.refusal}: {fault}")

    def _exhausted(self, now: float) -> bool:
        """Return whether the battery has been critical for long enough to trigger its failsafe."""
        if self.volts >= self.params.of("BATT_CRT_VOLT"):
            self._charged_at = now
        return now - self._charged_at > self.params.of("BATT_LOW_TIMER") and bool(self.params.of("BATT_FS_CRT_ACT"))

    def _fail_safe(self, now: float) -> None:
        silent = 0.0 if self.ground_station is None else now - self.ground_station
        if silent > self.params.of("FS_GCS_TIMEOUT") and self.params.of("FS_GCS_ENABLE"):
            self.report_text(WARNING, "GCS Failsafe")
        elif not self.estimator.ready and self.params.of("FS_EKF_ACTION"):
            self.report_text(CRITICAL, "EKF Failsafe: changed to LAND Mode")
        elif self.params.of("FS_THR_ENABLE"):
            self.report_text(WARNING, "Radio Failsafe")
        elif self._exhausted(now):
            self.report_text(CRITICAL, f"Battery 1 is critical {self.volts:.2f}V: landing")
        else:
            return
        self.enter(LAND, now, FAILSAFE_PAUSE)

    def _touch_down(self, now: float) -> None:
        if now - self.guidance.descends < 1.0 or abs(self.estimator.estimate.velocity[2]) > 0.1:
            self._still = None
            return
        self._still = now if self._still is None else self._still
        if now - self._still > 1.0:
            self.landed = True
            if not self.waits_for_pilot:  # there is no pilot to disarm
                self.disarm(force=False)

    def report_text(self, severity: int, text: str) -> None:
        self.texts.append((severity, text))
