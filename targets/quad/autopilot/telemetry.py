"""Telemetry of the autopilot: flight mode, arming, position and present setpoint.

The module also requests the autopilot's message streams.

Positions are in local ENU about the fleet's origin, computed from GLOBAL_POSITION_INT. LOCAL_POSITION_NED is not used
for them, because it is relative to the vehicle's own EKF origin, which no other robot shares.

Heights are AMSL throughout (GLOBAL_POSITION_INT.alt; frame 5, MAV_FRAME_GLOBAL_INT, in setpoints). They are not
relative to home, because each vehicle has its own home, which is reset to the vehicle's place at each arming.
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

VOUCHED = 2.0  # seconds for which an EKF status report counts as current
_NO_POSITION = 0x007  # bits of the type_mask in POSITION_TARGET messages: ignore x, y and z
LONG_AGO = 2000  # ms; if a message's boot time is this much older than the newest one, the autopilot has restarted


class Streams:
    """Requests for the autopilot's message streams by SET_MESSAGE_INTERVAL.

    An autopilot sends these streams only on request, and forgets the requests when it restarts. So each request is
    repeated while its stream is missing."""

    def __init__(self) -> None:
        self._came: dict[int, float] = {}  # message id -> time of the last message
        self._asked: dict[int, float] = {}  # message id -> time of the last request

    def note(self, message: int, now: float) -> None:
        """Record that a message with this id was received."""
        self._came[message] = now

    def poll(self, link: Link, firmware: Firmware, now: float) -> None:
        """Request each missing stream once a second, and each stream of occasional messages every two seconds."""
        for message, rate in firmware.rates.items():
            occasional = message in firmware.occasional
            silent = now - self._came.get(message, -math.inf) > 1.0
            if (silent or occasional) and now - self._asked.get(message, -math.inf) >= (2.0 if occasional else 1.0):
                self._asked[message] = now
                link.send_once(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message, 1e6 / rate)

    def restart(self) -> None:
        """Forget all requests, because the autopilot has restarted: the next poll requests all streams again."""
        self._came.clear()
        self._asked.clear()


class Telemetry:
    """Last known state of the vehicle. A field is None until its value is received."""

    def __init__(self, frame: LocalFrame) -> None:
        self._frame = frame
        self._local: tuple[Point, Point] | None = None  # last position about the EKF's origin, and `position` then
        self.firmware = ARDUPILOT  # assumed until the firmware is known
        self._boot: int | None = None  # ms since the autopilot's boot, in its newest position message
        self._earlier: int | None = None  # boot time (ms) of the last message if it is not the newest, else None
        self._ekf: int | None = None  # flags of the last EKF status report
        self._ekf_time = -math.inf  # time at which the last EKF status report arrived
        self.restarts = 0  # number of restarts of the autopilot that were detected
        self.mode: int | None = None  # flight mode: HEARTBEAT.custom_mode
        self.mode_time = -math.inf  # time at which the last heartbeat arrived
        self.armed = False
        self.landed: int | None = None  # state as in MAV_LANDED_STATE: on the ground, in the air, ...
        self.position: Point | None = None
        self.velocity = Point()  # velocity in ENU, m/s
        self.yaw: float | None = None  # rad from east; None if the autopilot does not know the yaw
        self.time: float | None = None  # time at which `position` arrived
        self.amsl = 0.0  # m, altitude AMSL
        self.relative = 0.0  # m, height above home
        self.battery: float | None = None  # battery charge, 0 to 1
        self.followed: Point | None = None  # the position setpoint that the autopilot reports
        self.followed_time = -math.inf  # time at which the last report of the setpoint arrived

    def update(self, message: Message, now: float) -> None:
        """Update the state from one message of the vehicle."""
        if message.get_msgId() not in self.firmware.rates:
            return
        match message.get_msgId():
            case mavlink.MAVLINK_MSG_ID_HEARTBEAT:
                self.mode, self.mode_time = message.custom_mode, now
                self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
            case mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT:
                self._update_position(message, now)
            case mavlink.MAVLINK_MSG_ID_SYS_STATUS:  # battery charge in percent; -1: unknown to the autopilot
                self.battery = message.battery_remaining / 100 if 0 <= message.battery_remaining <= 100 else None
            case mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE:
                self.landed = message.landed_state or None
            case mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT | mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS:
                # The flags have the same bits in both messages.
                self._ekf, self._ekf_time = message.flags, now
            case mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT:
                if math.isfinite(message.alt):  # AMSL, independent of the frame in which the setpoint was sent
                    place = self._frame.enu(message.lat_int * 1e-7, message.lon_int * 1e-7, message.alt)
                    self.followed, self.followed_time = Point(*place), now
            case mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED:
                if self.position is not None and self.fresh(now):
                    self._local = Point(message.y, message.x, -message.z), self.position
            case mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED:
                self._update_local_target(message, now)

    def _update_local_target(self, message: Message, now: float) -> None:
        """Convert a setpoint reported relative to the EKF's own origin to the fleet's frame.

        The EKF's origin need not be known: the offset of the setpoint from the vehicle's local position suffices."""
        if self._local is None or message.type_mask & _NO_POSITION:
            return
        here, position = self._local
        target = position + (Point(message.y, message.x, -message.z) - here)
        if transmissible(target):
            self.followed, self.followed_time = target, now

    def _update_position(self, message: Message, now: float) -> None:
        if not self._is_newest(message.time_boot_ms):
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
        # `time` is the time of arrival, not of sending. A simulated autopilot's clock may run more slowly than the
        # agent's, so the delay of a message cannot be distinguished from the drift of the clocks.
        self.time = now

    def _is_newest(self, boot: int) -> bool:
        """Return whether a message is newer than all earlier messages.

        `boot`: time of the message in ms since the autopilot's boot.

        A message that was duplicated or overtaken in transit must not count as fresh. If the times of two successive
        messages increase, but are LONG_AGO or more before the newest one, the autopilot has restarted."""
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
        """Return whether the EKF has an absolute position.

        The rule is that of ArduPilot (Copter::ekf_has_absolute_position)."""
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
