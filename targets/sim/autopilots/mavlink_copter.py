"""What state a simulated copter is in: its mode, arming, landed or not, and the failsafes that change it.

Behaves as was observed on ArduPilot 4.7: a mode set in the first second after boot is acknowledged and lost; arming is
refused in words; it disarms 10 s after an arming that no take-off followed; GUIDED leaves the ground by NAV_TAKEOFF
only, some seconds later, for its motors spin up first; it lands 5 s after the last heartbeat of its ground station,
and when it has lost its position: a failsafe's LAND hovers for 4 s before it descends.
"""

from __future__ import annotations

import math
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from targets.sim.autopilots.mavlink_estimate import Estimator
from targets.sim.autopilots.mavlink_guided import Aim, Guidance, Vector
from targets.sim.autopilots.mavlink_params import Parameters

STABILIZE, ALT_HOLD, GUIDED, LOITER, LAND, POSHOLD, BRAKE = 0, 2, 4, 5, 9, 16, 17
MODES = (STABILIZE, ALT_HOLD, GUIDED, LOITER, LAND, POSHOLD, BRAKE)
ACCEPTED: int = mavlink.MAV_RESULT_ACCEPTED
DENIED: int = mavlink.MAV_RESULT_DENIED
FAILED: int = mavlink.MAV_RESULT_FAILED
UNSUPPORTED: int = mavlink.MAV_RESULT_UNSUPPORTED
MODE_LOST = 1.0  # seconds after boot in which a mode is acknowledged and forgotten
FAILSAFE_PAUSE = 4.0  # seconds for which a failsafe's LAND hovers first (LAND_WITH_DELAY_MS)
# Seconds from the take-off command until it leaves the ground, as observed: what is left of ARMING_DELAY (2 s), the
# motors' spin-up (MOT_SPOOL_TIME) and the ramp of the thrust (TKOFF_SLEW_TIME).
SPOOL_UP = 3.3
LIFTS = 0.3  # of these, the last ones, in which it begins to rise
IGNORE_PILOT_YAW = 4  # of GUID_OPTIONS
SPINNING_RELEASE = (4, 7)
COMPLAINS = 30.0  # seconds from one telling of what hinders arming to the next
WARNING, CRITICAL, INFO = mavlink.MAV_SEVERITY_WARNING, mavlink.MAV_SEVERITY_CRITICAL, mavlink.MAV_SEVERITY_INFO


class Copter:
    """Modes and arming. `said` collects STATUSTEXTs as (severity, text) for the telemetry to send."""

    autopilot: int = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    refusal = "PreArm"  # how the words begin in which it tells what hinders arming
    fragile = True  # a position that is not finite aborts it
    resets_datum = True  # the EKF resets its height datum after an origin from outside
    odometry_frames: tuple[int, ...] = (mavlink.MAV_FRAME_LOCAL_FRD,)  # that it takes an ODOMETRY in

    def __init__(self, boot: float, params: Parameters, spool_up: float = SPOOL_UP) -> None:
        self._boot, self._spool_up = boot, spool_up
        self.params = params
        self.guidance = Guidance()
        self.estimator: Estimator  # which tells us what it has to say
        self.said: list[tuple[int, str]] = []
        self.mode = STABILIZE
        self.armed = False
        self.landed = True
        self.home: Vector | None = None
        self.failing_check = ""  # what a pre-arm check complains about, when one does
        self.ground_station: float | None = None  # when its last heartbeat came
        self.volts = math.inf  # of the battery
        self._charged = -math.inf  # when these were last enough
        self._armed_at = 0.0
        self._rise: tuple[float, float] | None = None  # when a take-off begins that was commanded, and to what height
        self._still: float | None = None
        self._complained: float | None = None

    @property
    def position(self) -> Vector:
        """Where it believes to be."""
        return self.estimator.estimate.position

    @property
    def following(self) -> bool:
        """Whether setpoints are obeyed: in GUIDED, and off the ground; else they are dropped in silence."""
        return self.mode == GUIDED and self.armed and not self.landed

    @property
    def spins(self) -> bool:
        """Whether GUIDED takes the missing receiver's yaw stick for one that is pushed to its end, as development
        builds of 4.7.0 did where FS_THR_ENABLE is 0 (github.com/ArduPilot/ardupilot/issues/31353)."""
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
        """Whether it says what setpoint it has."""
        return self.mode == GUIDED

    @property
    def landing(self) -> bool:
        return self.mode == LAND

    @property
    def waits_for_pilot(self) -> bool:
        """Whether it stays armed after a landing."""
        return bool(self.params.of("LAND_REPOSITION"))

    def heard_heartbeat(self, system: int, now: float) -> None:
        """Only its ground station's count."""
        if system == self.params.of("MAV_GCS_SYSID"):
            self.ground_station = now

    def heard_setpoint(self, now: float) -> None:
        """A setpoint came, whatever becomes of it. ArduPilot does not count them."""

    def refuse_setpoint(self, now: float) -> None:
        """One that makes no sense came: stop."""
        self.guidance.stop(now, self.position)

    def booted(self, now: float) -> bool:
        return self.estimator.started is not None and now - self.estimator.started >= self._boot + MODE_LOST

    def heartbeat(self) -> tuple[int, int]:
        """Base and custom mode."""
        flags = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
        if self.mode == GUIDED:
            flags |= mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
        if self.armed:
            flags |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        return flags, self.mode

    def command(self, message: Any, now: float) -> int | None:
        """DO_SET_MODE, arming and take-off, as a MAV_RESULT; None for any other command."""
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
        """DO_CHANGE_SPEED: airspeed, ground speed, climb or descent, until the aim is another. A MAV_RESULT."""
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
        """A MAV_RESULT."""
        if mode not in MODES:
            return DENIED
        if mode == GUIDED and not self.estimator.ready:
            self.say(WARNING, "Mode change to GUIDED failed: requires position")
            return FAILED
        if self.booted(now):
            self.enter(mode, now)
        return ACCEPTED

    def enter(self, mode: int, now: float, pause: float = 0.0) -> None:
        """Change the mode, without asking: as a remote control or a failsafe does. LAND descends after a pause (s)."""
        if mode == self.mode:
            return
        self.mode = mode
        self._still = self._rise = None
        x, y, z = self.position
        match mode:
            case _ if mode == LAND:
                self.guidance.land(now, (x, y, z if self.home is None else self.home[2]), pause)
            case _ if mode == STABILIZE:
                self.guidance.go(Aim.FALL, now, (x, y, z))
            case _:
                self.guidance.stop(now, (x, y, z))

    def fault(self, now: float) -> str:
        """What hinders arming; "" when nothing does."""
        if self.failing_check:
            return self.failing_check
        if self.params.of("FS_THR_ENABLE"):
            return "RC not found"
        return self.estimator.fault(now)

    def arm(self, now: float) -> int:
        """A MAV_RESULT."""
        if self.armed:
            return ACCEPTED
        fault = self.fault(now)
        if fault:
            self.say(CRITICAL, f"{self.refusal}: {fault}")
            return FAILED
        if self.mode == LAND:
            self.say(CRITICAL, "Arm: LAND mode not armable")
            return FAILED
        self.armed, self._armed_at, self.home = True, now, self.position
        guidance, of = self.guidance, self.params.of
        guidance.default_speed = of("WP_SPD")
        guidance.default_up, guidance.default_down = of("WP_SPD_UP"), of("WP_SPD_DN")
        guidance.take_default_speeds()
        self.guidance.timeout = self.params.of("GUID_TIMEOUT")
        self.guidance.looks_ahead = self.params.of("WP_YAW_BEHAVIOR") != 0
        self.guidance.stop(now, self.position)
        self.guidance.turn(self.estimator.estimate.yaw, 0.0)
        self.say(INFO, "Arming motors")
        return ACCEPTED

    def run_checks(self, now: float) -> int:
        """Say what hinders arming, without arming. A MAV_RESULT."""
        if self.armed:
            return int(mavlink.MAV_RESULT_TEMPORARILY_REJECTED)
        fault = self.fault(now)
        if fault:
            self.say(CRITICAL, f"{self.refusal}: {fault}")
        return ACCEPTED

    def disarm(self, force: bool) -> int:
        """A MAV_RESULT; in flight only by force."""
        if not self.landed and not force:
            return FAILED
        if self.armed:
            self.armed, self.landed, self._rise = False, True, None
            self.say(INFO, "Disarming motors")
        return ACCEPTED

    def take_off(self, above_home: float, now: float) -> int:
        """A MAV_RESULT."""
        if self.mode != GUIDED or not self.armed or not self.landed or self.home is None:
            return FAILED
        height = self.home[2] + above_home
        if not height > self.position[2]:
            return FAILED
        begins = now + max(0.0, self._spool_up - LIFTS) if self._rise is None else self._rise[0]
        self._rise = begins, height
        return ACCEPTED

    def _lift_off(self, now: float) -> None:
        """Rise, when the motors have spun up for it."""
        if self._rise is not None and now >= self._rise[0]:
            x, y, _ = self.position
            self.landed = False
            self.guidance.go(Aim.TAKEOFF, now, (x, y, self._rise[1]))
            self._rise = None

    def reposition(self, place: Vector, changes_mode: bool, now: float) -> int:
        """DO_REPOSITION. A MAV_RESULT."""
        if self.mode != GUIDED and not (changes_mode and self.set_mode(GUIDED, now) == ACCEPTED):
            return DENIED
        if not self.following:
            return FAILED
        self.guidance.go(Aim.POSITION, now, place)
        return ACCEPTED

    def watch(self, now: float) -> None:
        """What happens by itself: complaints, auto-disarm, touch-down, failsafes."""
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
        if self._complained is None or now - self._complained >= COMPLAINS:
            self._complained = now
            fault = self.fault(now)
            if fault:
                self.say(CRITICAL, f"{self.refusal}: {fault}")

    def _exhausted(self, now: float) -> bool:
        """Whether the battery has been critical for so long that something is to be done about it."""
        if self.volts >= self.params.of("BATT_CRT_VOLT"):
            self._charged = now
        return now - self._charged > self.params.of("BATT_LOW_TIMER") and bool(self.params.of("BATT_FS_CRT_ACT"))

    def _fail_safe(self, now: float) -> None:
        silent = 0.0 if self.ground_station is None else now - self.ground_station
        if silent > self.params.of("FS_GCS_TIMEOUT") and self.params.of("FS_GCS_ENABLE"):
            self.say(WARNING, "GCS Failsafe")
        elif not self.estimator.ready and self.params.of("FS_EKF_ACTION"):
            self.say(CRITICAL, "EKF Failsafe: changed to LAND Mode")
        elif self.params.of("FS_THR_ENABLE"):
            self.say(WARNING, "Radio Failsafe")
        elif self._exhausted(now):
            self.say(CRITICAL, f"Battery 1 is critical {self.volts:.2f}V: landing")
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
            if not self.waits_for_pilot:  # who is not there
                self.disarm(force=False)

    def say(self, severity: int, text: str) -> None:
        self.said.append((severity, text))
