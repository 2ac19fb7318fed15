"""MAVLink messages of external positioning: GPS_INPUT, VISION_POSITION_ESTIMATE and ODOMETRY.

The functions take poses in the fleet's local ENU frame.
GPS_INPUT is geodetic; its velocity and yaw are in the NED axes at the robot's position.
VISION_POSITION_ESTIMATE and ODOMETRY are in the NED frame about the autopilot's own EKF origin, which need not be the
fleet's origin.

A pose's attitude contains the yaw only. Roll and pitch are sent as 0, and the EKF gets them from its own gyros. Values
that are not finite are never sent, because a NaN in a used field aborts the autopilot's process.
"""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from koordgen.runtime.values.geodesy import LocalFrame
from koordgen.runtime.values.points import Point, Pose
from targets.mavlink.framing import Message

# Start of GPS time (1980-01-06) in Unix time, leap seconds between GPS time and UTC, length of a week; all in seconds.
GPS_EPOCH, LEAP_SECONDS, WEEK = 315_964_800, 18, 604_800
# Standard deviations that are reported to the EKF. They are larger than those of a motion capture system.
HORIZONTAL, VERTICAL, SPEED = 0.02, 0.02, 0.1  # horizontal position (m), vertical position (m), velocity (m/s)
ANGLE = 0.02  # radians
_DILUTION, _SATELLITES = 0.5, 16  # dilution of precision, number of satellites: better than arming checks demand

# Indices of the diagonal in a 6 x 6 covariance matrix that is sent as its upper triangle, row by row.
_DIAGONAL = (0, 6, 11, 15, 18, 20)


def gps_input(frame: LocalFrame, pose: Pose, velocity: Point, unix: float) -> Message:
    """Return GPS_INPUT: a fix with position, velocity, yaw and their accuracies.

    `velocity`: m/s, ENU. `unix`: time of the fix, seconds since 1970."""
    p = pose.position
    latitude, longitude, altitude = frame.geodetic(p.x, p.y, p.z)
    vn, ve, vd = frame.ned(latitude, longitude, velocity.x, velocity.y, velocity.z)
    north, east, _ = frame.ned(latitude, longitude, math.cos(pose.yaw), math.sin(pose.yaw), 0.0)
    yaw = round(math.degrees(math.atan2(east, north)) * 100) % 36_000 or 36_000  # 0 denotes no yaw
    week, ms = divmod(round((unix - GPS_EPOCH + LEAP_SECONDS) * 1000), WEEK * 1000)
    return mavlink.MAVLink_gps_input_message(
        round(unix * 1e6), 0, 0, ms, week, mavlink.GPS_FIX_TYPE_3D_FIX,
        round(latitude * 1e7), round(longitude * 1e7), altitude, _DILUTION, _DILUTION, vn, ve, vd,
        SPEED, HORIZONTAL, VERTICAL, _SATELLITES, yaw,
    )  # fmt: skip


class Ned:
    """Conversion from the fleet's ENU frame to the NED frame about an EKF origin.

    `latitude`, `longitude` (degrees) and `altitude` (m AMSL) are those of the EKF origin."""

    def __init__(self, frame: LocalFrame, latitude: float, longitude: float, altitude: float) -> None:
        self.origin = (latitude, longitude, altitude)
        self._fleet, self._ekf = frame, LocalFrame(latitude, longitude, altitude)

    def position(self, p: Point) -> tuple[float, float, float]:
        """Return a position as metres north, east and down of the EKF origin."""
        east, north, up = self._ekf.enu(*self._fleet.geodetic(p.x, p.y, p.z))
        return north, east, -up

    def direction(self, v: Point, at: Point) -> tuple[float, float, float]:
        """Convert a velocity or direction at the point `at` from the fleet's ENU axes to NED axes.

        The vector is first turned to the NED axes at that point, and then to the NED axes of the EKF origin."""
        latitude, longitude, _ = self._fleet.geodetic(at.x, at.y, at.z)
        east, north, up = self._ekf.turned(latitude, longitude, *self._fleet.ned(latitude, longitude, v.x, v.y, v.z))
        return north, east, -up

    def yaw(self, pose: Pose) -> float:
        """Return a pose's yaw in radians clockwise from north, within -pi to pi."""
        north, east, _ = self.direction(Point(math.cos(pose.yaw), math.sin(pose.yaw), 0.0), pose.position)
        return math.atan2(east, north)


def vision(ned: Ned, pose: Pose, time: float, resets: int) -> Message:
    """Return VISION_POSITION_ESTIMATE for a pose that was measured at `time`.

    `time` is in seconds on any monotonic clock, since the autopilot compensates the offset to its own clock. `resets`
    counts the jumps of the pose that the EKF must follow."""
    covariance = _covariance(HORIZONTAL, VERTICAL, ANGLE)
    return mavlink.MAVLink_vision_position_estimate_message(
        round(time * 1e6), *ned.position(pose.position), 0.0, 0.0, ned.yaw(pose), covariance, resets % 256
    )


def odometry(ned: Ned, pose: Pose, velocity: Point, time: float, resets: int, autopilot: int) -> Message:
    """Return ODOMETRY for a pose and a velocity (m/s, ENU) that were measured at `time`.

    `time` and `resets` are those of `vision`. The message carries the velocity in the vehicle's own axes: forward,
    right, down. ArduPilot accepts a pose in MAV_FRAME_LOCAL_FRD only, and treats this frame as NED. PX4 treats
    LOCAL_FRD as a frame of unknown heading, so PX4 gets the pose in MAV_FRAME_LOCAL_NED."""
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
