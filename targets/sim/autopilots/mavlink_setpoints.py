"""Decoder of SET_POSITION_TARGET_GLOBAL_INT and _LOCAL_NED that follows ArduPilot's guided mode.

Position, velocity and acceleration are used whole or not at all, and an acceleration only with a velocity. (ArduPilot
also accepts an acceleration alone; this is not simulated.) An unknown frame or mask stops the vehicle. On the ground
every setpoint is dropped silently. A position that is not finite aborts the autopilot."""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from koordgen.runtime.values.geodesy import LocalFrame
from targets.sim.autopilots.mavlink_copter import DENIED, Copter
from targets.sim.autopilots.mavlink_guided import STILL, GuidanceMode, Vector
from targets.sim.autopilots.mavlink_telemetry import Message

NO_POSITION, NO_VELOCITY, NO_ACCELERATION = 0x007, 0x038, 0x1C0
FORCE, NO_YAW, NO_YAW_RATE = 0x200, 0x400, 0x800
AMSL = (mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT)
ABOVE_HOME = (mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)
LOCAL = (mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_BODY_NED)  # about the EKF's origin
OFFSET = (mavlink.MAV_FRAME_LOCAL_OFFSET_NED, mavlink.MAV_FRAME_BODY_OFFSET_NED)  # about the vehicle's position
BODY = (mavlink.MAV_FRAME_BODY_NED, mavlink.MAV_FRAME_BODY_OFFSET_NED)  # x forward, for offsets and velocities
AIMS = {
    (True, False): GuidanceMode.POSITION,
    (False, True): GuidanceMode.VELOCITY,
    (True, True): GuidanceMode.POSITION_VELOCITY,
}


def handle_setpoint(message: Message, copter: Copter, frame: LocalFrame, now: float) -> bool:
    """Apply a setpoint to the copter's guidance. Return False if it has aborted the autopilot."""
    copter.heard_setpoint(now)
    estimate, ekf = copter.estimator.estimate, copter.estimator.origin
    if not copter.following or ekf is None:
        return True
    uses = _used_fields(message.type_mask)
    globally = message.get_msgId() == mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT
    if uses is None or message.coordinate_frame not in (AMSL + ABOVE_HOME if globally else LOCAL + OFFSET):
        copter.refuse_setpoint(now)
        return True
    position, velocity, push = estimate.position, STILL, STILL
    if uses[0]:
        if not all(map(math.isfinite, (message.alt,) if globally else (message.x, message.y, message.z))):
            return not copter.fragile
        position = _global(message, copter, frame) if globally else _local(message, copter, frame, ekf)
    if uses[1]:
        velocity = _to_enu(message, message.vx, message.vy, message.vz, estimate.yaw)
    if not message.type_mask & NO_ACCELERATION:
        push = _to_enu(message, message.afx, message.afy, message.afz, estimate.yaw)
    if not all(map(math.isfinite, velocity + push)):
        return True
    copter.guidance.go(AIMS[uses], now, position, velocity, push)
    yaw = None if message.type_mask & NO_YAW or not math.isfinite(message.yaw) else math.pi / 2 - message.yaw
    rate = 0.0 if message.type_mask & NO_YAW_RATE or not math.isfinite(message.yaw_rate) else -message.yaw_rate
    copter.guidance.turn(yaw, rate)
    return True


def reposition(message: Message, copter: Copter, frame: LocalFrame, now: float) -> int:
    """Execute DO_REPOSITION in a COMMAND_INT: fly there and hold. Return a MAV_RESULT."""
    if message.frame not in AMSL + ABOVE_HOME or not math.isfinite(message.z) or not math.isfinite(message.param2):
        return DENIED
    altitude = message.z + (_home_altitude(copter, frame) if message.frame in ABOVE_HOME else 0.0)
    place = frame.enu(message.x * 1e-7, message.y * 1e-7, altitude)
    changes_mode = bool(int(message.param2) & mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE)
    return copter.reposition(place, changes_mode, now)


def _home_altitude(copter: Copter, frame: LocalFrame) -> float:
    return 0.0 if copter.home is None else frame.geodetic(*copter.home)[2]


def _used_fields(mask: int) -> tuple[bool, bool] | None:
    """Return whether position and velocity are used.

    None for an invalid mask: a part of a group, or an acceleration without velocity."""
    ignored = [mask & group for group in (NO_POSITION, NO_VELOCITY, NO_ACCELERATION)]
    whole = all(i in (0, group) for i, group in zip(ignored, (NO_POSITION, NO_VELOCITY, NO_ACCELERATION), strict=True))
    uses = not ignored[0], not ignored[1]
    return uses if whole and (ignored[2] or uses[1]) and not mask & FORCE and any(uses) else None


def _global(message: Message, copter: Copter, frame: LocalFrame) -> Vector:
    altitude = message.alt
    if message.coordinate_frame in ABOVE_HOME:
        altitude += _home_altitude(copter, frame)
    return frame.enu(message.lat_int * 1e-7, message.lon_int * 1e-7, altitude)


def _local(message: Message, copter: Copter, frame: LocalFrame, ekf: LocalFrame) -> Vector:
    if message.coordinate_frame in LOCAL:
        return frame.enu(*ekf.geodetic(message.y, message.x, -message.z))
    estimate = copter.estimator.estimate
    x, y, z = _to_enu(message, message.x, message.y, message.z, estimate.yaw)
    here = estimate.position
    return here[0] + x, here[1] + y, here[2] + z


def _to_enu(message: Message, x: float, y: float, z: float, yaw: float) -> Vector:
    """Convert a vector from the message's frame (NED or FRD) to ENU."""
    if message.coordinate_frame not in BODY:
        return y, x, -z
    return x * math.cos(yaw) + y * math.sin(yaw), x * math.sin(yaw) - y * math.cos(yaw), -z
