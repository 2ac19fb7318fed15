"""MAVLink messages that a simulated copter reports its state in, each built when it is due.

A builder returns None if there is nothing to report. As GCS_MAVLINK_Copter of ArduPilot 4.7: without a position,
GLOBAL_POSITION_INT is all zeros. The target in global coordinates is reported for position-only setpoints, the local
one for all."""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from koordgen.runtime.values.geodesy import LocalFrame
from targets.sim.autopilots.mavlink_copter import Copter
from targets.sim.autopilots.mavlink_guided import STILL, GuidanceMode, Vector
from targets.sim.autopilots.mavlink_telemetry import Maker, Message
from targets.sim.base.fault_state import FaultState

OFFICIAL, DEVELOPMENT = 255, 0  # FIRMWARE_VERSION_TYPE
CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
)  # fmt: skip
POSITION_ONLY, NO_POSITION, NO_YAW = 0xDF8, 0x007, 0xC00  # type masks of a reported target
ENDURANCE = 1200.0  # seconds in the air from full to empty
CAPACITY = 5.0  # Ah
FULL, EMPTY = 12.6, 10.5  # V, three cells
HOVERING, IDLE = 15.0, 0.5  # A
SENSORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY | mavlink.MAV_SYS_STATUS_AHRS
)  # fmt: skip
POSITIONED = {
    "own": mavlink.MAV_SYS_STATUS_SENSOR_GPS,
    "gps_input": mavlink.MAV_SYS_STATUS_SENSOR_GPS,
    "vision": mavlink.MAV_SYS_STATUS_SENSOR_VISION_POSITION,
}
ARMABLE = mavlink.MAV_SYS_STATUS_PREARM_CHECK


class Reports:
    """Builders of reports by message number. `frame` is the fleet's."""

    def __init__(self, copter: Copter, frame: LocalFrame, fault_state: FaultState | None = None) -> None:
        self.copter, self.frame = copter, frame
        self._charge = 1.0  # share of the battery's charge that flying has left
        self._fault_state = fault_state or FaultState()
        self._drained: float | None = None
        self._seen = 0.0
        self.makers: dict[int, Maker] = {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: self.heartbeat,
            mavlink.MAVLINK_MSG_ID_SYS_STATUS: self._status,
            mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: self._time,
            mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: self._gps,
            mavlink.MAVLINK_MSG_ID_ATTITUDE: self._attitude,
            mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: self._quaternion,
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._global_position,
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self._local_position,
            mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: self._local_target,
            mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: self._global_target,
            mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: self._extended_state,
            mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: self._ekf_status,
            mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: self._battery,
            mavlink.MAVLINK_MSG_ID_HOME_POSITION: self._home,
            mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: self._origin,
            mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: self.version,
        }

    @property
    def battery(self) -> float:
        """Share of the battery's charge that is left."""
        return min(self._charge, self._fault_state.battery)

    def drain(self, now: float) -> None:
        """Drain the battery for the time in the air."""
        if self._drained is not None and self.copter.armed and not self.copter.landed:
            self._charge = max(0.0, self._charge - (now - self._drained) / ENDURANCE)
        self._drained = now

    def clock(self, now: float) -> int:
        """Return the milliseconds since boot, never 0."""
        return 1 + round((now - (self.copter.estimator.started or 0.0)) * 1000)

    def heartbeat(self, now: float) -> Message:
        self.drain(now)
        base, custom = self.copter.heartbeat()
        status = mavlink.MAV_STATE_STANDBY if self.copter.landed else mavlink.MAV_STATE_ACTIVE
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_QUADROTOR, self.copter.autopilot, base, custom, status, 3
        )

    def _status(self, now: float) -> Message:
        copter, positioned = self.copter, POSITIONED.get(self.copter.estimator.source, 0)
        present, health = SENSORS | positioned | ARMABLE, SENSORS
        if copter.estimator.ready:
            health |= positioned
        if copter.armed or not copter.fault(now):
            health |= ARMABLE
        return mavlink.MAVLink_sys_status_message(
            present, present, health, 200, self._millivolts, round(self._current * 100), round(self.battery * 100),
            0, 0, 0, 0, 0, 0,
        )  # fmt: skip

    def _time(self, now: float) -> Message:
        """Report no time of day: the world's clock begins at 0."""
        return mavlink.MAVLink_system_time_message(0, self.clock(now))

    @property
    def volts(self) -> float:
        """Voltage of the battery."""
        return EMPTY + (FULL - EMPTY) * self.battery

    @property
    def _millivolts(self) -> int:
        return round(self.volts * 1000)

    @property
    def _current(self) -> float:
        return HOVERING if self.copter.armed and not self.copter.landed else IDLE

    def _battery(self, now: float) -> Message:
        cells = [self._millivolts // 3] * 3 + [65535] * 7
        used = round((1 - self.battery) * CAPACITY * 1000)
        return mavlink.MAVLink_battery_status_message(
            0, mavlink.MAV_BATTERY_FUNCTION_ALL, mavlink.MAV_BATTERY_TYPE_LIPO, 32767, cells,
            round(self._current * 100), used, -1, round(self.battery * 100),
        )  # fmt: skip

    def _gps(self, now: float) -> Message:
        known = self.copter.estimator.ready and self.copter.estimator.source in ("own", "gps_input")
        latitude, longitude, altitude = self.place(self.copter.position) if known else (0, 0, 0.0)
        fix = mavlink.GPS_FIX_TYPE_3D_FIX if known else mavlink.GPS_FIX_TYPE_NO_FIX
        speed = math.hypot(*self.copter.estimator.estimate.velocity[:2])
        return mavlink.MAVLink_gps_raw_int_message(
            self.clock(now) * 1000, fix, latitude, longitude, round(altitude * 1e3), 80, 100, round(speed * 100), 65535,
            12 if known else 0,
        )  # fmt: skip

    def _heading(self) -> float:
        """Return the heading in radians clockwise from north, within -pi to pi."""
        return math.remainder(math.pi / 2 - self.copter.estimator.estimate.yaw, math.tau)

    def _attitude(self, now: float) -> Message:
        return mavlink.MAVLink_attitude_message(self.clock(now), 0.0, 0.0, self._heading(), 0.0, 0.0, 0.0)

    def _quaternion(self, now: float) -> Message:
        half = self._heading() / 2
        return mavlink.MAVLink_attitude_quaternion_message(
            self.clock(now), math.cos(half), 0.0, 0.0, math.sin(half), 0.0, 0.0, 0.0
        )

    def place(self, p: Vector) -> tuple[int, int, float]:
        """Return latitude and longitude (1e-7 degrees) and altitude (m) of a point in the fleet's frame."""
        latitude, longitude, altitude = self.frame.geodetic(*p)
        return round(latitude * 1e7), round(longitude * 1e7), altitude

    def _global_position(self, now: float) -> Message:
        estimator = self.copter.estimator
        if estimator.origin is None:
            return mavlink.MAVLink_global_position_int_message(self.clock(now), 0, 0, 0, 0, 0, 0, 0, 0)
        latitude, longitude, altitude = self.place(estimator.estimate.position)
        home = estimator.place[2] if self.copter.home is None else self.place(self.copter.home)[2]
        vx, vy, vz = (round(v * 100) for v in estimator.estimate.velocity)
        heading = round(math.degrees(self._heading()) * 100) % 36000
        return mavlink.MAVLink_global_position_int_message(
            self.clock(now), latitude, longitude, round(altitude * 1e3), round((altitude - home) * 1e3),
            vy, vx, -vz, heading,
        )  # fmt: skip

    def ned(self, p: Vector) -> Vector | None:
        """Convert a point of the fleet's frame to NED about the EKF's origin; None without an origin."""
        origin = self.copter.estimator.origin
        if origin is None:
            return None
        east, north, up = origin.enu(*self.frame.geodetic(*p))
        return north, east, -up

    def _local_position(self, now: float) -> Message | None:
        here = self.ned(self.copter.position)
        if here is None:
            return None
        vx, vy, vz = self.copter.estimator.estimate.velocity
        return mavlink.MAVLink_local_position_ned_message(self.clock(now), *here, vy, vx, -vz)

    def _local_target(self, now: float) -> Message | None:
        guidance = self.copter.guidance
        target = self.ned(guidance.position)
        if target is None or not self.copter.shows_target:
            return None
        match guidance.aim:
            case GuidanceMode.POSITION:
                mask, (vx, vy, vz) = POSITION_ONLY, STILL
            case GuidanceMode.TAKEOFF:  # ArduPilot reports the target of GUIDED here, which a take-off does not have
                mask, (vx, vy, vz), target = POSITION_ONLY, STILL, STILL
            case GuidanceMode.POSITION_VELOCITY:
                mask, (vx, vy, vz) = NO_YAW, guidance.velocity
            case _:
                mask, (vx, vy, vz), target = NO_YAW | NO_POSITION, guidance.velocity, STILL
        return mavlink.MAVLink_position_target_local_ned_message(
            self.clock(now), mavlink.MAV_FRAME_LOCAL_NED, mask, *target, vy, vx, -vz, 0, 0, 0, 0, 0
        )

    def _global_target(self, now: float) -> Message | None:
        guidance = self.copter.guidance
        if not self.copter.shows_target or guidance.aim is not GuidanceMode.POSITION:
            return None
        return mavlink.MAVLink_position_target_global_int_message(
            self.clock(now), mavlink.MAV_FRAME_GLOBAL, 0xF000 | POSITION_ONLY, *self.place(guidance.position),
            0, 0, 0, 0, 0, 0, 0, 0,
        )  # fmt: skip

    def _extended_state(self, now: float) -> Message:
        if self.copter.landed:
            state = mavlink.MAV_LANDED_STATE_ON_GROUND
        elif self.copter.landing:
            state = mavlink.MAV_LANDED_STATE_LANDING
        elif self.copter.guidance.aim is GuidanceMode.TAKEOFF:
            state = mavlink.MAV_LANDED_STATE_TAKEOFF
        else:
            state = mavlink.MAV_LANDED_STATE_IN_AIR
        return mavlink.MAVLink_extended_sys_state_message(mavlink.MAV_VTOL_STATE_UNDEFINED, state)

    def _ekf_status(self, now: float) -> Message:
        return mavlink.MAVLink_ekf_status_report_message(self.copter.estimator.flags, 0.01, 0.01, 0.01, 0.01, 0.0)

    def _home(self, now: float) -> Message | None:
        home = self.copter.home or (self.copter.position if self.copter.estimator.ready else None)
        local = None if home is None else self.ned(home)
        if home is None or local is None:
            return None
        latitude, longitude, altitude = self.place(home)
        return mavlink.MAVLink_home_position_message(
            latitude, longitude, round(altitude * 1e3), *local, [1, 0, 0, 0], 0, 0, 0
        )

    def _origin(self, now: float) -> Message | None:
        if self.copter.estimator.origin is None:
            return None
        latitude, longitude, altitude = self.copter.estimator.place
        return mavlink.MAVLink_gps_global_origin_message(
            round(latitude * 1e7), round(longitude * 1e7), round(altitude * 1e3)
        )

    def version(self, now: float) -> Message:
        nothing = [0] * 8
        major, minor = self.copter.params.release
        kind = DEVELOPMENT if self.copter.params.development else OFFICIAL
        return mavlink.MAVLink_autopilot_version_message(
            CAPABILITIES, major << 24 | minor << 16 | kind, 0, 0, 0, nothing, nothing, nothing, 0, 0, 1
        )
