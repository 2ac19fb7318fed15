"""EKF origin of an autopilot with external positioning, set by the agent if there is none yet.

An EKF that receives local positions needs an origin on earth. The EKF accepts the first SET_GPS_GLOBAL_ORIGIN after its
initialisation; it loses earlier messages and ignores later ones. So the message is repeated until the autopilot reports
global positions. Poses are then sent relative to the origin that the autopilot reports.

The requested origin has the latitude and longitude of the fleet's origin, and the altitude of the robot. ArduPilot
resets its height datum after the first origin, and from then on counts the robot's height above the origin twice. So
the robot's height above the requested origin must be zero.
"""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from koordgen.runtime.values.geodesy import LocalFrame
from koordgen.runtime.values.points import Pose
from targets.mavlink.framing import Message
from targets.mavlink.link import Link
from targets.quad.autopilot.external import Ned

EVERY = 1.0  # seconds between two requests to the autopilot for its origin
LIFTED = 0.02  # m by which the robot's height must change before the requested origin changes


class Origin:
    """EKF origin of one autopilot.

    `ned`: conversion of poses to the NED frame about this origin. `resets`: how often this frame has changed."""

    def __init__(self, frame: LocalFrame, origin: tuple[float, float, float]) -> None:
        self._frame, self._fleet = frame, origin
        self._height = 0.0  # m, height of the requested origin above the fleet's origin
        self._boot = 0  # ms since the autopilot's boot, in its last GLOBAL_POSITION_INT
        self._reported: tuple[int, int, int] | None = None  # reported origin, in units of `_wanted`
        self._next = -math.inf  # earliest time of the next request
        self._initialised = False  # whether the EKF is initialised
        self._placed = False  # whether the autopilot reports global positions
        self._asked = 0  # how often the autopilot was asked for its origin since it booted
        self.ned = self._about(self._wanted)
        self.resets = 0

    @property
    def _wanted(self) -> tuple[int, int, int]:
        """The requested origin: latitude and longitude in 1e-7 degrees, altitude in millimetres AMSL."""
        latitude, longitude, altitude = self._fleet
        return round(latitude * 1e7), round(longitude * 1e7), round((altitude + self._height) * 1e3)

    def update(self, message: Message) -> None:
        """Process one message of the vehicle."""
        match message.get_msgId():
            case mavlink.MAVLINK_MSG_ID_STATUSTEXT:
                self._initialised |= "EKF3 IMU" in str(message.text) and "initialised" in str(message.text)
            case mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT:  # for agents that missed the STATUSTEXT
                self._initialised |= bool(message.flags & mavlink.EKF_ATTITUDE)
            case mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT:
                if message.time_boot_ms + 1000 < self._boot:  # the autopilot has restarted
                    self._initialised, self._reported, self._asked = False, None, 0
                self._boot, self._placed = message.time_boot_ms, bool(message.lat or message.lon)
            case mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN:
                self._record_origin((message.latitude, message.longitude, message.altitude))

    def _record_origin(self, reported: tuple[int, int, int]) -> None:
        if abs(reported[0]) > 900_000_000 or abs(reported[1]) > 1_800_000_000 or not any(reported):
            return
        self._reported = reported
        self._refer(reported)

    def _refer(self, place: tuple[int, int, int]) -> None:
        ned = self._about(place)
        if ned.origin != self.ned.origin:
            self.ned = ned
            self.resets += 1

    def _about(self, place: tuple[int, int, int]) -> Ned:
        return Ned(self._frame, place[0] * 1e-7, place[1] * 1e-7, place[2] * 1e-3)

    @property
    def known(self) -> bool:
        """Return whether `ned` uses the autopilot's present origin.

        This is the case once the autopilot has reported its origin. It is also the case if the autopilot has answered
        no request for its origin and reports no global positions, because it then has no origin yet."""
        return self._reported is not None or (self._asked > 1 and not self._placed)

    def poll(self, link: Link, pose: Pose | None, now: float) -> None:
        """Request the autopilot's origin until it is known, and set an origin while the autopilot has none.

        An origin is set only if the robot's `pose` (ENU about the fleet's origin) is known, because the origin gets the
        robot's altitude."""
        if link.vehicle is None or now < self._next or (self._reported is not None and self._placed):
            return
        self._next = now + EVERY
        if self._reported is None:
            self._asked += 1
            link.send_once(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)
        if pose is None or self._placed:
            return
        if self._reported is None and abs(pose.position.z - self._height) > LIFTED:
            self._height = pose.position.z
            self._refer(self._wanted)
        if self._initialised or link.vehicle.autopilot != mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA:
            link.send(mavlink.MAVLink_set_gps_global_origin_message(link.vehicle.system, *self._wanted))
