"""Reads SET_POSITION_TARGET_GLOBAL_INT and _LOCAL_NED the way ArduPilot's guided mode does.

Position, velocity and acceleration are used whole or not at all; a frame or mask that is none stops the vehicle; on the
ground everything is dropped in silence; a position that is not finite aborts the autopilot.
"""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from koordgen.runtime.geodesy import LocalFrame
from targets.sim.mavlink_copter import Copter
from targets.sim.mavlink_guided import Aim, Vector
from targets.sim.mavlink_telemetry import Estimate, Message

NO_POSITION, NO_VELOCITY, NO_ACCELERATION = 0x007, 0x038, 0x1C0
FORCE, NO_YAW, NO_YAW_RATE = 0x200, 0x400, 0x800
AMSL = (mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT)
ABOVE_HOME = (mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)
LOCAL = (mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_BODY_NED)  # about the EKF's origin
OFFSET = (mavlink.MAV_FRAME_LOCAL_OFFSET_NED, mavlink.MAV_FRAME_BODY_OFFSET_NED)  # about where the vehicle is
BODY = (mavlink.MAV_FRAME_BODY_NED, mavlink.MAV_FRAME_BODY_OFFSET_NED)  # x forward, for offsets and velocities
AIMS = {(True, False): Aim.POSITION, (False, True): Aim.VELOCITY, (True, True): Aim.POSITION_VELOCITY}


def take_setpoint(
    message: Message, copter: Copter, frame: LocalFrame, ekf: LocalFrame, estimate: Estimate, now: float
) -> bool:
    """Change the copter's aim as the message says. False when it has killed the autopilot."""
    if not copter.armed or copter.landed:
        return True
    uses = _uses(message.type_mask)
    globally = message.get_msgId() == mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT
    if uses is None or message.coordinate_frame not in (AMSL + ABOVE_HOME if globally else LOCAL + OFFSET):
        copter.guidance.stop(now, estimate.position)
        return True
    position, velocity = estimate.position, (0.0, 0.0, 0.0)
    if uses[0]:
        if not all(map(math.isfinite, (message.alt,) if globally else (message.x, message.y, message.z))):
            return False
        position = _global(message, copter, frame) if globally else _local(message, frame, ekf, estimate)
    if uses[1]:
        velocity = _velocity(message, estimate.yaw)
        if not all(map(math.isfinite, velocity)):
            return True
    copter.guidance.go(AIMS[uses], now, position, velocity)
    if not message.type_mask & NO_YAW and math.isfinite(message.yaw):
        copter.guidance.yaw = math.pi / 2 - message.yaw
    return True


def _uses(mask: int) -> tuple[bool, bool] | None:
    """Whether position and velocity are used; None when a part of a group is, or acceleration (not simulated)."""
    ignored = [mask & group for group in (NO_POSITION, NO_VELOCITY, NO_ACCELERATION)]
    whole = all(i in (0, group) for i, group in zip(ignored, (NO_POSITION, NO_VELOCITY, NO_ACCELERATION), strict=True))
    uses = not ignored[0], not ignored[1]
    return uses if whole and ignored[2] and not mask & FORCE and any(uses) else None


def _global(message: Message, copter: Copter, frame: LocalFrame) -> Vector:
    altitude = message.alt
    if message.coordinate_frame in ABOVE_HOME:
        altitude += frame.geodetic(*copter.home)[2]
    return frame.enu(message.lat_int * 1e-7, message.lon_int * 1e-7, altitude)


def _local(message: Message, frame: LocalFrame, ekf: LocalFrame, estimate: Estimate) -> Vector:
    if message.coordinate_frame in LOCAL:
        return frame.enu(*ekf.geodetic(message.y, message.x, -message.z))
    x, y = message.y, message.x
    if message.coordinate_frame in BODY:
        x, y = _turned(message.x, -message.y, estimate.yaw)
    here = estimate.position
    return here[0] + x, here[1] + y, here[2] - message.z


def _velocity(message: Message, yaw: float) -> Vector:
    if message.coordinate_frame in BODY:
        return (*_turned(message.vx, -message.vy, yaw), -message.vz)
    return message.vy, message.vx, -message.vz


def _turned(forward: float, left: float, yaw: float) -> tuple[float, float]:
    return forward * math.cos(yaw) - left * math.sin(yaw), forward * math.sin(yaw) + left * math.cos(yaw)
