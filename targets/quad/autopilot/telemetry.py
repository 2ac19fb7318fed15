"""What the autopilot says of itself: mode, arming, position, what it follows; and asking for it to be said.

Positions: local ENU about the FLEET's origin, from GLOBAL_POSITION_INT. LOCAL_POSITION_NED would be about the vehicle's
own EKF origin, which no other robot shares. Heights are AMSL throughout (GLOBAL_POSITION_INT.alt, frame 5 in
setpoints), not relative to home: home is where the vehicle was armed, each vehicle's own, and moves when it arms.
"""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from koordgen.runtime.values.geodesy import LocalFrame
from koordgen.runtime.values.points import Point, transmissible
from targets.mavlink.framing import Message
from targets.mavlink.link import Link
from targets.quad.autopilot.ardupilot import ARDUPILOT
from targets.quad.autopilot.firmware import Firmware

VOUCHED = 2.0  # seconds for which a report of the estimate's state holds
_NO_POSITION = 0x007  # bits of a type mask
LONG_AGO = 2000  # ms, more than a message may be late


class Streams:
    """Asks for each stream by SET_MESSAGE_INTERVAL, and again when it is not there: nothing streams until asked, and
    an autopilot that restarted has forgotten."""

    def __init__(self) -> None:
        self._came: dict[int, float] = {}
        self._asked: dict[int, float] = {}

    def note(self, message: int, now: float) -> None:
        """A message of this id has come."""
        self._came[message] = now

    def poll(self, link: Link, firmware: Firmware, now: float) -> None:
        """Ask for what is missing; of what comes only now and then, every two seconds."""
        for message, rate in firmware.rates.items():
            occasional = message in firmware.occasional
            silent = now - self._came.get(message, -math.inf) > 1.0
            if (silent or occasional) and now - self._asked.get(message, -math.inf) >= (2.0 if occasional else 1.0):
                self._asked[message] = now
                link.tell(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message, 1e6 / rate)

    def restart(self) -> None:
        """The autopilot has restarted: ask for everything at once."""
        self._came.clear()
        self._asked.clear()


class Telemetry:
    """The vehicle's last known state. None stands for what has not been heard yet."""

    def __init__(self, frame: LocalFrame) -> None:
        self._frame = frame
        self._local: tuple[Point, Point] | None = None  # position about the EKF's origin, and `position` at that time
        self.firmware = ARDUPILOT  # until it is known
        self._boot: int | None = None  # ms, the vehicle's clock in the newest message
        self._earlier: int | None = None  # ... in a last one that was older than that
        self._ekf: int | None = None
        self._ekf_time = -math.inf
        self.restarts = 0
        self.mode: int | None = None
        self.mode_time = -math.inf
        self.armed = False
        self.landed: int | None = None  # MAV_LANDED_STATE
        self.position: Point | None = None
        self.velocity = Point()  # m/s, ENU
        self.yaw: float | None = None  # rad from east; None where the autopilot does not know it
        self.time: float | None = None  # when `position` came
        self.amsl = 0.0  # m
        self.relative = 0.0  # m above home
        self.battery: float | None = None  # charge, 0 to 1
        self.followed: Point | None = None  # the position target that the autopilot says it has
        self.followed_time = -math.inf

    def take(self, message: Message, now: float) -> None:
        """Take one of the vehicle's messages."""
        if message.get_msgId() not in self.firmware.rates:
            return
        match message.get_msgId():
            case mavlink.MAVLINK_MSG_ID_HEARTBEAT:
                self.mode, self.mode_time = message.custom_mode, now
                self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
            case mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT:
                self._take_position(message, now)
            case mavlink.MAVLINK_MSG_ID_SYS_STATUS:  # percent; -1: the autopilot does not know it
                self.battery = message.battery_remaining / 100 if 0 <= message.battery_remaining <= 100 else None
            case mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE:
                self.landed = message.landed_state or None
            case mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT | mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS:  # same flags
                self._ekf, self._ekf_time = message.flags, now
            case mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT:
                if math.isfinite(message.alt):  # always AMSL here, whatever frame was asked for
                    place = self._frame.enu(message.lat_int * 1e-7, message.lon_int * 1e-7, message.alt)
                    self.followed, self.followed_time = Point(*place), now
            case mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED:
                if self.position is not None and self.fresh(now):
                    self._local = Point(message.y, message.x, -message.z), self.position
            case mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED:
                self._take_local_target(message, now)

    def _take_local_target(self, message: Message, now: float) -> None:
        """Its origin is the EKF's own, which needs not be known: how far the target is from the vehicle suffices."""
        if self._local is None or message.type_mask & _NO_POSITION:
            return
        here, position = self._local
        target = position + (Point(message.y, message.x, -message.z) - here)
        if transmissible(target):
            self.followed, self.followed_time = target, now

    def _take_position(self, message: Message, now: float) -> None:
        if not self._news(message.time_boot_ms):
            return
        if (message.lat == 0 and message.lon == 0) or not self._estimating(now):
            return
        latitude, longitude = message.lat * 1e-7, message.lon * 1e-7
        self.amsl, self.relative = message.alt * 1e-3, message.relative_alt * 1e-3
        self.position = Point(*self._frame.enu(latitude, longitude, self.amsl))
        self.velocity = Point(
            *self._frame.turned(latitude, longitude, message.vx * 0.01, message.vy * 0.01, message.vz * 0.01)
        )
        known = message.hdg < 36000
        self.yaw = math.remainder(math.pi / 2 - math.radians(message.hdg / 100), math.tau) if known else None
        # When it came, not when it was sent: a simulated autopilot's clock may run slower than ours, so that the lag
        # of a single message cannot be told from their drift.
        self.time = now

    def _news(self, boot: int) -> bool:
        """Whether a message with this time is newer than all before. What is repeated or was overtaken on the way must
        not look fresh; two in a row that run on from long before mean that the vehicle's clock began anew."""
        if self._boot is not None and boot <= self._boot:
            runs_on = self._earlier is not None and 0 < boot - self._earlier < LONG_AGO
            self._earlier = boot
            if not runs_on or self._boot - boot < LONG_AGO:
                return False
            self._restarted()
        self._boot, self._earlier = boot, None
        return True

    def _restarted(self) -> None:
        self.restarts += 1
        self._ekf = self.landed = self.position = self.time = self.followed = self._local = None

    def _estimating(self, now: float) -> bool:
        """Whether the EKF knows where it is, as ArduPilot itself decides it (Copter::ekf_has_absolute_position)."""
        if self._ekf is None or now - self._ekf_time > VOUCHED:
            return False
        absolute = bool(self._ekf & mavlink.EKF_POS_HORIZ_ABS)
        if self.armed:
            return absolute and not self._ekf & mavlink.EKF_CONST_POS_MODE
        return absolute or bool(self._ekf & mavlink.EKF_PRED_POS_HORIZ_ABS)

    @property
    def flying(self) -> bool:
        """Return whether the vehicle is armed and off the ground."""
        return self.armed and self.landed is not None and self.landed != mavlink.MAV_LANDED_STATE_ON_GROUND

    def fresh(self, now: float, age: float = 0.5) -> bool:
        """Return whether the position is not older than `age` seconds."""
        return self.time is not None and now - self.time <= age

    @property
    def mode_name(self) -> str:
        return self.firmware.mode(self.mode)
