"""What is sent to an autopilot that is told where it is: GPS_INPUT, VISION_POSITION_ESTIMATE, ODOMETRY.

Poses come in the fleet's local ENU. GPS_INPUT is geodetic, its velocity and yaw in the NED axes of the place; the other
two are in the NED frame about the autopilot's own EKF origin, which need not be the fleet's. Only yaw is measured:
roll and pitch are sent as 0, and the EKF takes them from its own gyros. Nothing is sent that is not finite: a NaN in a
used field aborts the autopilot's process.
"""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from koordgen.runtime.values.geodesy import LocalFrame
from koordgen.runtime.values.points import Point, Pose
from targets.mavlink.framing import Message

GPS_EPOCH, LEAP_SECONDS, WEEK = 315_964_800, 18, 604_800  # seconds; 1980-01-06 in Unix time
HORIZONTAL, VERTICAL, SPEED = 0.02, 0.02, 0.1  # metres, m/s: what a motion capture system errs by, generously
ANGLE = 0.02  # radians
_DILUTION, _SATELLITES = 0.5, 16  # better than what arming checks ask for
# Upper triangles of 6 x 6 matrices, row by row; the diagonal stands at these places.
_DIAGONAL = (0, 6, 11, 15, 18, 20)


def gps_input(frame: LocalFrame, pose: Pose, velocity: Point, unix: float) -> Message:
    """Return a fix at `unix` (seconds since 1970): position, velocity (m/s, ENU), yaw and how good they are."""
    p = pose.position
    latitude, longitude, altitude = frame.geodetic(p.x, p.y, p.z)
    vn, ve, vd = frame.ned(latitude, longitude, velocity.x, velocity.y, velocity.z)
    north, east, _ = frame.ned(latitude, longitude, math.cos(pose.yaw), math.sin(pose.yaw), 0.0)
    yaw = round(math.degrees(math.atan2(east, north)) * 100) % 36_000 or 36_000  # 0 would mean that there is none
    week, ms = divmod(round((unix - GPS_EPOCH + LEAP_SECONDS) * 1000), WEEK * 1000)
    return mavlink.MAVLink_gps_input_message(
        round(unix * 1e6), 0, 0, ms, week, mavlink.GPS_FIX_TYPE_3D_FIX,
        round(latitude * 1e7), round(longitude * 1e7), altitude, _DILUTION, _DILUTION, vn, ve, vd,
        SPEED, HORIZONTAL, VERTICAL, _SATELLITES, yaw,
    )  # fmt: skip


class Ned:
    """Brings poses of the fleet's frame to the NED frame about an EKF origin (degrees, degrees, metres AMSL)."""

    def __init__(self, frame: LocalFrame, latitude: float, longitude: float, altitude: float) -> None:
        self.origin = (latitude, longitude, altitude)
        self._fleet, self._ekf = frame, LocalFrame(latitude, longitude, altitude)

    def position(self, p: Point) -> tuple[float, float, float]:
        """North, east, down, metres."""
        east, north, up = self._ekf.enu(*self._fleet.geodetic(p.x, p.y, p.z))
        return north, east, -up

    def direction(self, v: Point, at: Point) -> tuple[float, float, float]:
        """A velocity or direction at a point: its place's own axes are on the way from one frame to the other."""
        latitude, longitude, _ = self._fleet.geodetic(at.x, at.y, at.z)
        east, north, up = self._ekf.turned(latitude, longitude, *self._fleet.ned(latitude, longitude, v.x, v.y, v.z))
        return north, east, -up

    def yaw(self, pose: Pose) -> float:
        """Radians clockwise from north, within -pi to pi."""
        north, east, _ = self.direction(Point(math.cos(pose.yaw), math.sin(pose.yaw), 0.0), pose.position)
        return math.atan2(east, north)


def vision(ned: Ned, pose: Pose, time: float, resets: int) -> Message:
    """VISION_POSITION_ESTIMATE of a pose measured at `time` (seconds on any clock that runs on: the autopilot takes out
    the difference)."""
    covariance = _covariance(HORIZONTAL, VERTICAL, ANGLE)
    return mavlink.MAVLink_vision_position_estimate_message(
        round(time * 1e6), *ned.position(pose.position), 0.0, 0.0, ned.yaw(pose), covariance, resets % 256
    )


def odometry(ned: Ned, pose: Pose, velocity: Point, time: float, resets: int, autopilot: int) -> Message:
    """ODOMETRY likewise, with the velocity (m/s, ENU) in the vehicle's own axes (forward, right, down). ArduPilot
    takes no other frames than these and means NED by LOCAL_FRD; PX4 means by that a frame of unknown heading."""
    local = autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    yaw = ned.yaw(pose)
    vn, ve, vd = ned.direction(velocity, pose.position)
    forward, right = vn * math.cos(yaw) + ve * math.sin(yaw), ve * math.cos(yaw) - vn * math.sin(yaw)
    return mavlink.MAVLink_odometry_message(
        round(time * 1e6), mavlink.MAV_FRAME_LOCAL_FRD if local else mavlink.MAV_FRAME_LOCAL_NED,
        mavlink.MAV_FRAME_BODY_FRD, *ned.position(pose.position),
        [math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)], forward, right, vd, 0.0, 0.0, 0.0,
        _covariance(HORIZONTAL, VERTICAL, ANGLE), _covariance(SPEED, SPEED, ANGLE), resets % 256,
        mavlink.MAV_ESTIMATOR_TYPE_MOCAP, 100,
    )  # fmt: skip


def _covariance(horizontal: float, vertical: float, angle: float) -> list[float]:
    deviations = (horizontal, horizontal, vertical, angle, angle, angle)
    found = [0.0] * 21
    for at, deviation in zip(_DIAGONAL, deviations, strict=True):
        found[at] = deviation * deviation
    return found
