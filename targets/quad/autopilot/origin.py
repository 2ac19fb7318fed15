"""The EKF's origin of an autopilot that flies by external positions: set once, or taken as it is.

An EKF that was told positions without a place on earth needs one. It takes the first SET_GPS_GLOBAL_ORIGIN after it is
initialised; what is sent earlier is lost, and later ones change nothing. So it is sent until positions are told on the
globe, and what the autopilot says of its origin is what poses are sent about.

The origin is the fleet's latitude and longitude at the robot's own altitude. ArduPilot resets its height datum after
the first origin, and from then on counts the robot's height above the origin twice: it must be zero.
"""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from koordgen.runtime.values.geodesy import LocalFrame
from koordgen.runtime.values.points import Pose
from targets.mavlink.framing import Message
from targets.mavlink.link import Link
from targets.quad.autopilot.external import Ned

EVERY = 1.0  # seconds between two askings
LIFTED = 0.02  # m by which the robot's height must change for the origin that is asked for to change


class Origin:
    """`ned` is what poses are to be sent about; `resets` counts how often it changed."""

    def __init__(self, frame: LocalFrame, origin: tuple[float, float, float]) -> None:
        self._frame, self._fleet = frame, origin
        self._height = 0.0  # m above the fleet's origin, of the origin that is asked for
        self._boot = 0  # ms, in the last position told
        self._told: tuple[int, int, int] | None = None
        self._next = -math.inf
        self._initialised = False
        self._placed = False  # positions are told on the globe
        self._asked = 0  # how often the autopilot was asked for its origin since it booted
        self.ned = self._about(self._wanted)
        self.resets = 0

    @property
    def _wanted(self) -> tuple[int, int, int]:
        """Degrees * 1e7, degrees * 1e7, millimetres AMSL."""
        latitude, longitude, altitude = self._fleet
        return round(latitude * 1e7), round(longitude * 1e7), round((altitude + self._height) * 1e3)

    def take(self, message: Message) -> None:
        """Take one of the vehicle's messages."""
        match message.get_msgId():
            case mavlink.MAVLINK_MSG_ID_STATUSTEXT:
                self._initialised |= "EKF3 IMU" in str(message.text) and "initialised" in str(message.text)
            case mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT:  # an agent that comes later has missed those words
                self._initialised |= bool(message.flags & mavlink.EKF_ATTITUDE)
            case mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT:
                if message.time_boot_ms + 1000 < self._boot:  # the autopilot restarted
                    self._initialised, self._told, self._asked = False, None, 0
                self._boot, self._placed = message.time_boot_ms, bool(message.lat or message.lon)
            case mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN:
                self._take_origin((message.latitude, message.longitude, message.altitude))

    def _take_origin(self, told: tuple[int, int, int]) -> None:
        if abs(told[0]) > 900_000_000 or abs(told[1]) > 1_800_000_000 or not any(told):
            return
        self._told = told
        self._refer(told)

    def _refer(self, place: tuple[int, int, int]) -> None:
        ned = self._about(place)
        if ned.origin != self.ned.origin:
            self.ned = ned
            self.resets += 1

    def _about(self, place: tuple[int, int, int]) -> Ned:
        return Ned(self._frame, place[0] * 1e-7, place[1] * 1e-7, place[2] * 1e-3)

    @property
    def known(self) -> bool:
        """Return whether `ned` is right: the autopilot has reported its origin, or it has none that it could report."""
        return self._told is not None or (self._asked > 1 and not self._placed)

    def poll(self, link: Link, pose: Pose | None, now: float) -> None:
        """Ask for the origin that is not known yet, and set it as long as there seems to be none and the robot's pose
        (ENU about the fleet's origin) is known."""
        if link.vehicle is None or now < self._next or (self._told is not None and self._placed):
            return
        self._next = now + EVERY
        if self._told is None:
            self._asked += 1
            link.tell(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)
        if pose is None or self._placed:
            return
        if self._told is None and abs(pose.position.z - self._height) > LIFTED:
            self._height = pose.position.z
            self._refer(self._wanted)
        if self._initialised or link.vehicle.autopilot != mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA:
            link.send(mavlink.MAVLink_set_gps_global_origin_message(link.vehicle.system, *self._wanted))
