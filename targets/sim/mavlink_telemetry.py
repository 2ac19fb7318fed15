"""What a simulated autopilot sends: a heartbeat once a second, and else only the messages that were asked for."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from koordgen.runtime.geodesy import LocalFrame
from targets.sim.mavlink_copter import GUIDED, LAND, Copter
from targets.sim.mavlink_guided import Aim, Vector

Message = Any  # one of the dialect's generated classes

VERSION = 4 << 24 | 7 << 16 | 255  # 4.7.0, official
IGNORED_BUT_POSITION = 0xFDF8  # the type mask that ArduPilot reports for a position target
_FAST, _NEVER = 1 / 50, math.inf  # seconds
_ESTIMATE = (
    mavlink.EKF_ATTITUDE | mavlink.EKF_VELOCITY_HORIZ | mavlink.EKF_VELOCITY_VERT | mavlink.EKF_POS_HORIZ_REL
    | mavlink.EKF_POS_HORIZ_ABS | mavlink.EKF_POS_VERT_ABS | mavlink.EKF_PRED_POS_HORIZ_ABS
)  # fmt: skip


@dataclass(slots=True)
class Estimate:
    """What the vehicle believes of itself: ENU about the fleet's origin, yaw in radians from east."""

    position: Vector = (0.0, 0.0, 0.0)
    velocity: Vector = (0.0, 0.0, 0.0)
    yaw: float = 0.0


class Telemetry:
    """Streams by SET_MESSAGE_INTERVAL. `frame` is the fleet's, `ekf` the vehicle's own, known after boot."""

    def __init__(self, copter: Copter, frame: LocalFrame, send: Callable[[Message], None]) -> None:
        self._copter, self._frame, self._send = copter, frame, send
        self.ekf: LocalFrame | None = None
        self.ekf_place: Vector = (0.0, 0.0, 0.0)  # degrees, degrees, metres
        self._makers: dict[int, Callable[[Estimate, float], Message | None]] = {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: self._heartbeat,
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._global_position,
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self._local_position,
            mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: self._extended_state,
            mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: self._ekf_status,
            mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: self._position_target,
            mavlink.MAVLINK_MSG_ID_HOME_POSITION: self._home,
            mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: self._origin,
            mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: self._version,
        }
        self._every: dict[int, float] = {mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0}
        self._due: dict[int, float] = {mavlink.MAVLINK_MSG_ID_HEARTBEAT: -math.inf}
        self._soonest = -math.inf

    def ask(self, message: int, interval: float, now: float) -> int:
        """SET_MESSAGE_INTERVAL with microseconds, 0 for the default and -1 for never. A MAV_RESULT."""
        if message not in self._makers or not math.isfinite(interval):
            return int(mavlink.MAV_RESULT_FAILED)
        if interval == 0:
            interval = 1e6 if message == mavlink.MAVLINK_MSG_ID_HEARTBEAT else -1
        self._every[message] = _NEVER if interval < 0 else max(_FAST, interval * 1e-6)
        self._due[message] = _NEVER if interval < 0 else now
        self._soonest = min(self._due.values())
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def once(self, message: int, estimate: Estimate, now: float) -> int:
        """REQUEST_MESSAGE. A MAV_RESULT."""
        made = self._makers[message](estimate, now) if message in self._makers else None
        if made is None:
            return int(mavlink.MAV_RESULT_FAILED)
        self._send(made)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def step(self, estimate: Estimate, now: float) -> None:
        """Send what is due, and what the copter has said."""
        for severity, text in self._copter.said:
            self._send(mavlink.MAVLink_statustext_message(severity, text[:50].encode("ascii", "replace")))
        self._copter.said.clear()
        if now < self._soonest:
            return
        for message, due in self._due.items():
            if now >= due:
                made = self._makers[message](estimate, now)
                if made is not None:
                    self._send(made)
                every = self._every[message]
                self._due[message] = now + every if now - due > every else due + every
        self._soonest = min(self._due.values())

    def _clock(self, now: float) -> int:
        """Milliseconds since boot, never 0."""
        return 1 + round((now - (self._copter.started or 0.0)) * 1000)

    def _heartbeat(self, estimate: Estimate, now: float) -> Message:
        flags = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
        if self._copter.mode == GUIDED:
            flags |= mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
        if self._copter.armed:
            flags |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        status = mavlink.MAV_STATE_STANDBY if self._copter.landed else mavlink.MAV_STATE_ACTIVE
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, flags, self._copter.mode, status, 3
        )

    def _place(self, p: Vector) -> tuple[int, int, float]:
        latitude, longitude, altitude = self._frame.geodetic(*p)
        return round(latitude * 1e7), round(longitude * 1e7), altitude

    def _global_position(self, estimate: Estimate, now: float) -> Message:
        if not self._copter.estimating(now):
            return mavlink.MAVLink_global_position_int_message(self._clock(now), 0, 0, 0, 0, 0, 0, 0, 0)
        latitude, longitude, altitude = self._place(estimate.position)
        home = self._place(self._copter.home)[2]
        vx, vy, vz = (round(v * 100) for v in estimate.velocity)
        heading = round(math.degrees(math.pi / 2 - estimate.yaw) * 100) % 36000
        return mavlink.MAVLink_global_position_int_message(
            self._clock(now), latitude, longitude, round(altitude * 1e3), round((altitude - home) * 1e3),
            vy, vx, -vz, heading,
        )  # fmt: skip

    def _local_position(self, estimate: Estimate, now: float) -> Message | None:
        if self.ekf is None:
            return None
        e, n, u = self.ekf.enu(*self._frame.geodetic(*estimate.position))
        vx, vy, vz = estimate.velocity
        return mavlink.MAVLink_local_position_ned_message(self._clock(now), n, e, -u, vy, vx, -vz)

    def _extended_state(self, estimate: Estimate, now: float) -> Message:
        if self._copter.landed:
            state = mavlink.MAV_LANDED_STATE_ON_GROUND
        elif self._copter.mode == LAND:
            state = mavlink.MAV_LANDED_STATE_LANDING
        elif self._copter.guidance.aim is Aim.TAKEOFF:
            state = mavlink.MAV_LANDED_STATE_TAKEOFF
        else:
            state = mavlink.MAV_LANDED_STATE_IN_AIR
        return mavlink.MAVLink_extended_sys_state_message(mavlink.MAV_VTOL_STATE_UNDEFINED, state)

    def _ekf_status(self, estimate: Estimate, now: float) -> Message:
        flags = _ESTIMATE if self._copter.estimating(now) else mavlink.EKF_UNINITIALIZED
        return mavlink.MAVLink_ekf_status_report_message(flags, 0.01, 0.01, 0.01, 0.01, 0.0)

    def _position_target(self, estimate: Estimate, now: float) -> Message | None:
        guidance = self._copter.guidance
        if self._copter.mode != GUIDED or guidance.aim not in (Aim.POSITION, Aim.POSITION_VELOCITY):
            return None
        latitude, longitude, altitude = self._place(guidance.position)
        return mavlink.MAVLink_position_target_global_int_message(
            self._clock(now), mavlink.MAV_FRAME_GLOBAL, IGNORED_BUT_POSITION, latitude, longitude, altitude,
            0, 0, 0, 0, 0, 0, 0, 0,
        )  # fmt: skip

    def _home(self, estimate: Estimate, now: float) -> Message | None:
        if self.ekf is None:
            return None
        place = self._frame.geodetic(*self._copter.home)
        e, n, u = self.ekf.enu(*place)
        return mavlink.MAVLink_home_position_message(
            round(place[0] * 1e7), round(place[1] * 1e7), round(place[2] * 1e3), n, e, -u, [1, 0, 0, 0], 0, 0, 0
        )

    def _origin(self, estimate: Estimate, now: float) -> Message | None:
        if self.ekf is None:
            return None
        latitude, longitude, altitude = self.ekf_place
        return mavlink.MAVLink_gps_global_origin_message(
            round(latitude * 1e7), round(longitude * 1e7), round(altitude * 1e3)
        )

    def _version(self, estimate: Estimate, now: float) -> Message:
        nothing = [0] * 8
        return mavlink.MAVLink_autopilot_version_message(0, VERSION, 0, 0, 0, nothing, nothing, nothing, 0, 0, 0)
