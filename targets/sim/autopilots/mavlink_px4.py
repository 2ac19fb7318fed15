"""Simulated PX4 multicopter: the part of its behaviour that an agent meets.

As docs.px4.io says (1.15: Offboard Mode, Safety, Parameter Reference): OFFBOARD is refused without a stream of
setpoints faster than 2 Hz, and left COM_OF_LOSS_T after the last one. In OFFBOARD it takes off towards a setpoint that
is higher. Modes are pairs of main and sub mode. Integers in PARAM_VALUE travel as their bytes. Its motion is not PX4's:
the body is flown as ArduPilot would. Of the failsafe actions, LAND and HOLD are simulated."""

from __future__ import annotations

import math
import struct
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from koordgen.runtime.values.geodesy import LocalFrame
from targets.sim.autopilots.mavlink_copter import ACCEPTED, CRITICAL, DENIED, INFO, WARNING, Copter
from targets.sim.autopilots.mavlink_guided import GuidanceMode, Vector
from targets.sim.autopilots.mavlink_params import REAL, Parameter, SimulatedParameters
from targets.sim.autopilots.mavlink_reports import Reports
from targets.sim.autopilots.mavlink_telemetry import Message
from targets.sim.base.fault_state import FaultState

REJECTED: int = mavlink.MAV_RESULT_TEMPORARILY_REJECTED


def custom_mode(main: int, sub: int = 0) -> int:
    """Return HEARTBEAT.custom_mode of a main and a sub mode (px4_custom_mode.h)."""
    return main << 16 | sub << 24


OFFBOARD, TAKEOFF, HOLD, LAND = custom_mode(6), custom_mode(4, 2), custom_mode(4, 3), custom_mode(4, 6)
POSITION = custom_mode(3)
MODES = (OFFBOARD, TAKEOFF, HOLD, LAND, POSITION)
GAP = 0.5  # seconds: setpoints must come faster than 2 Hz
STREAM = 1.0  # seconds of setpoints that OFFBOARD requires
RISES = 0.1  # metres by which a setpoint must be above the ground to cause a take-off
LANDS, HOLDS = 4, 5  # values of COM_OBL_RC_ACT
EXCEPT_OFFBOARD = 4  # bit of COM_RCL_EXCEPT
VERSION = 1 << 24 | 15 << 16 | 4 << 8 | 255
CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
)  # fmt: skip
INTEGER = mavlink.MAV_PARAM_TYPE_INT32
PARAMETERS = (
    Parameter("COM_DISARM_PRFLT", 10, REAL),
    Parameter("COM_OBL_RC_ACT", LANDS, INTEGER),
    Parameter("COM_OF_LOSS_T", 1, REAL),
    Parameter("COM_RCL_EXCEPT", EXCEPT_OFFBOARD, INTEGER),
    Parameter("EKF2_EV_CTRL", 0, INTEGER),
    Parameter("EKF2_GPS_CTRL", 7, INTEGER),
    Parameter("EKF2_HGT_REF", 1, INTEGER),
    Parameter("EKF2_MAG_TYPE", 0, INTEGER),
    Parameter("MAV_SYS_ID", 1, INTEGER),
    Parameter("MIS_TAKEOFF_ALT", 2.5, REAL),
)
_EXTERNAL = {"EKF2_GPS_CTRL": 0.0, "EKF2_HGT_REF": 3.0, "EKF2_MAG_TYPE": 5.0}
PREPARED = {"vision": {**_EXTERNAL, "EKF2_EV_CTRL": 11.0}, "odometry": {**_EXTERNAL, "EKF2_EV_CTRL": 15.0}}
# Default streams on a link to a companion, Hz (mavlink_main.cpp, MAVLINK_MODE_ONBOARD; those that agents read).
STREAMS = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 5.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 50.0,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 30.0,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 10.0,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: 0.5,
}


class Px4Parameters(SimulatedParameters):
    """PX4's parameters: one name each, integers sent as bytes."""

    def __init__(self, positioning: str) -> None:
        super().__init__(table=PARAMETERS)
        self.update(PREPARED.get(positioning, {}))

    def value_message(self, name: str, index: int = -1) -> Message | None:
        message = super().value_message(name, index)
        if message is not None and message.param_type == INTEGER:
            message.param_value = struct.unpack("<f", struct.pack("<i", int(message.param_value)))[0]
        return message

    def change(self, name: str, value: float) -> bool:
        if self.kind(name) == INTEGER and abs(value) < math.inf:
            value = float(struct.unpack("<i", struct.pack("<f", value))[0])
        return super().change(name, value)


class Px4(Copter):
    """PX4's flight modes and arming. Modes are numbers as `custom_mode` packs them."""

    autopilot: int = mavlink.MAV_AUTOPILOT_PX4
    refusal = "Preflight Fail"
    fragile = False
    resets_datum = False
    odometry_frames = (mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_LOCAL_FRD)

    def __init__(self, boot: float, params: SimulatedParameters, frame: LocalFrame) -> None:
        super().__init__(boot, params)
        self._frame = frame
        self.mode = HOLD
        self._setpoint: float | None = None  # time of the last setpoint
        self._streaming: float | None = None  # time since which setpoints arrive fast enough

    @property
    def following(self) -> bool:
        return self.mode == OFFBOARD and self.armed

    @property
    def shows_target(self) -> bool:
        return self.mode in (OFFBOARD, TAKEOFF)

    @property
    def landing(self) -> bool:
        return self.mode == LAND

    @property
    def waits_for_pilot(self) -> bool:
        return False

    def heard_setpoint(self, now: float) -> None:
        if self._setpoint is None or now - self._setpoint > GAP:
            self._streaming = now
        self._setpoint = now

    def heard_heartbeat(self, system: int, now: float) -> None:
        """Ignore heartbeats: no failsafe depends on them (NAV_DLL_ACT 0)."""

    def refuse_setpoint(self, now: float) -> None:
        """Drop an invalid setpoint."""

    def heartbeat(self) -> tuple[int, int]:
        flags = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        if self.armed:
            flags |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        return flags, self.mode

    def command(self, message: Any, now: float) -> int | None:
        match message.command:
            case mavlink.MAV_CMD_DO_SET_MODE:
                modes = message.param2, message.param3
                if not all(math.isfinite(m) and 0 <= m < 256 for m in modes):
                    return DENIED
                return self.set_mode(custom_mode(int(modes[0]), int(modes[1])), now)
            case mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
                return self.arm(now) if message.param1 == 1 else self.disarm(force=message.param2 == 21196)
            case mavlink.MAV_CMD_NAV_TAKEOFF:
                if math.isfinite(message.param7):
                    ground = self._frame.geodetic(*self.position)[2]
                    self.params["MIS_TAKEOFF_ALT"] = max(1.0, message.param7 - ground)
                return self.set_mode(TAKEOFF, now)
            case mavlink.MAV_CMD_RUN_PREARM_CHECKS:
                return self.run_checks(now)
            case mavlink.MAV_CMD_NAV_LAND:
                return self.set_mode(LAND, now)
        return None

    def set_mode(self, mode: int, now: float) -> int:
        if mode not in MODES:
            return DENIED
        if mode == POSITION or not self.estimator.ready or (mode == OFFBOARD and not self._has_setpoint_stream(now)):
            self.report_text(CRITICAL, "Switching to this mode is currently not available")
            return REJECTED
        self.enter(mode, now)
        return ACCEPTED

    def _has_setpoint_stream(self, now: float) -> bool:
        """Return whether setpoints arrive fast enough, and have for long enough."""
        if self._setpoint is None or self._streaming is None:
            return False
        return now - self._setpoint <= GAP and now - self._streaming >= STREAM

    def enter(self, mode: int, now: float, pause: float = 0.0) -> None:
        """Change the mode without a check, as a remote control or a failsafe does.

        LAND descends after `pause` (s)."""
        if mode == self.mode:
            return
        self.mode = mode
        self._still = None
        x, y, z = self.position
        if mode == LAND:
            self.guidance.land(now, (x, y, z if self.home is None else self.home[2]), pause)
        elif mode == TAKEOFF:
            self.guidance.go(GuidanceMode.TAKEOFF, now, (x, y, z + self.params["MIS_TAKEOFF_ALT"]))
        else:
            self.guidance.stop(now, (x, y, z))

    def fault(self, now: float) -> str:
        return self.failing_check or ("" if self.estimator.ready else "no valid position estimate")

    def arm(self, now: float) -> int:
        if self.armed:
            return ACCEPTED
        fault = self.fault(now)
        if fault:
            self.report_text(CRITICAL, f"{self.refusal}: {fault}")
            return REJECTED
        self.armed, self._armed_at, self.home = True, now, self.position
        self.guidance.turn(self.estimator.estimate.yaw, 0.0)
        self.guidance.looks_ahead = False
        self.report_text(INFO, "Armed by external command")
        return ACCEPTED

    def disarm(self, force: bool) -> int:
        result = super().disarm(force)
        return REJECTED if result != ACCEPTED else result

    def reposition(self, place: Vector, changes_mode: bool, now: float) -> int:
        """Execute DO_REPOSITION: HOLD at another position."""
        if not self.armed or self.landed:
            return REJECTED
        self.enter(HOLD, now)
        self.guidance.go(GuidanceMode.POSITION, now, place)
        return ACCEPTED

    def watch(self, now: float) -> None:
        """Do what happens without a command: take-off and its end, auto-disarm, touch-down, failsafes."""
        if not self.armed:
            return
        guidance, height = self.guidance, self.position[2]
        if self.landed:
            rises = (
                guidance.aim is GuidanceMode.TAKEOFF
                or guidance.position[2] > height + RISES
                or guidance.velocity[2] > RISES
            )
            if self.mode in (OFFBOARD, TAKEOFF) and rises:
                self.landed = False
            elif now - self._armed_at > self.params["COM_DISARM_PRFLT"]:
                self.disarm(force=False)
        elif self.mode == LAND:
            self._touch_down(now)
            return
        elif self.mode == TAKEOFF and height > guidance.position[2] - 0.2:
            self.enter(HOLD, now)
        self._fail_safe(now)

    def _fail_safe(self, now: float) -> None:
        silent = now - (self._armed_at if self._setpoint is None else self._setpoint)
        action = LAND
        if self.mode == OFFBOARD and silent > self.params["COM_OF_LOSS_T"]:
            self.report_text(WARNING, "Failsafe activated: offboard control lost")
            action = LAND if self.params["COM_OBL_RC_ACT"] == LANDS else HOLD
        elif self.mode == OFFBOARD and not int(self.params["COM_RCL_EXCEPT"]) & EXCEPT_OFFBOARD:
            self.report_text(WARNING, "Failsafe activated: manual control lost")
        elif not self.estimator.ready:
            self.report_text(CRITICAL, "Failsafe activated: position lost")
        else:
            return
        self.enter(action, now)


class Px4Reports(Reports):
    """PX4's reports: estimator state in ESTIMATOR_STATUS, no target in global coordinates."""

    def __init__(self, copter: Copter, frame: LocalFrame, fault_state: FaultState | None = None) -> None:
        super().__init__(copter, frame, fault_state)
        del self.makers[mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT]
        del self.makers[mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT]
        self.makers[mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS] = self._estimator_status

    def _estimator_status(self, now: float) -> Message:
        return mavlink.MAVLink_estimator_status_message(
            self.clock(now) * 1000, self.copter.estimator.flags, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.05, 0.05
        )

    def version(self, now: float) -> Message:
        nothing = [0] * 8
        return mavlink.MAVLink_autopilot_version_message(
            CAPABILITIES, VERSION, 0, 0, 0, nothing, nothing, nothing, 0, 0, 1
        )
