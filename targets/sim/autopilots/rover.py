"""Simulated ArduPilot rover: obeys stick overrides in MANUAL, and drives a body.

As observed on ArduPilot 4.7: it sends only heartbeats until other messages are requested. A mode set in the first
second after boot is acknowledged and lost. Overrides count only from system 255 (MAV_GCS_SYSID), 1000 to 2000 with a
dead zone of 30 about 1500; more than 1500 is a right turn. It drives on for RC_OVERRIDE_TIME after the last override,
then goes neutral. A request for an unknown parameter is not answered. In modes other than MANUAL this rover stands
still: GUIDED is not simulated."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from koordgen.runtime.values.geodesy import LocalFrame
from targets.car.base.settings import decode
from targets.sim.autopilots.mavlink_params import BYTE, REAL, SHORT, Parameter, SimulatedParameters
from targets.sim.autopilots.mavlink_telemetry import Message, SimulatedTelemetry
from targets.sim.base.bodies import CarBody, DeviceContext
from targets.sim.base.ports import Port

MANUAL, HOLD, GUIDED = 0, 4, 15
MODES = (MANUAL, HOLD, GUIDED)
GROUND_STATION = 255
DEAD_ZONE, MIDDLE, END = 30, 1500, 2000
MODE_LOST = 1.0  # seconds after boot in which a new mode is acknowledged and forgotten
SUPPLY = 11.1  # volts
VERSION = 4 << 24 | 7 << 16 | 255  # 4.7.0, official
_ENDS = {"MIN": 1000, "TRIM": 1500, "MAX": 2000, "DZ": 30, "REVERSED": 0}
# Values of a rover prepared for a companion computer and without a remote control.
PARAMETERS = (
    Parameter("FS_ACTION", 2),
    Parameter("FS_GCS_ENABLE", 1),
    Parameter("FS_GCS_TIMEOUT", 2, REAL),
    Parameter("FS_THR_ENABLE", 0),
    Parameter("MANUAL_OPTIONS", 0, SHORT),
    Parameter("MANUAL_STR_EXPO", 0, REAL),
    Parameter("MAV_GCS_SYSID", 255, SHORT, (4, 7), "SYSID_MYGCS"),
    Parameter("MOT_SLEWRATE", 0, SHORT),
    Parameter("PILOT_STEER_TYPE", 0),
    *(Parameter(f"RC{channel}_{end}", value, SHORT) for channel in (1, 3) for end, value in _ENDS.items()),
    Parameter("RCMAP_ROLL", 1, BYTE),
    Parameter("RCMAP_THROTTLE", 3, BYTE),
    Parameter("RC_OPTIONS", 32, REAL),
    Parameter("RC_OVERRIDE_TIME", 0.5, REAL),
    Parameter("WP_SPEED", 2, REAL),
)
_KNOWS = mavlink.EKF_ATTITUDE | mavlink.EKF_POS_HORIZ_ABS | mavlink.EKF_VELOCITY_HORIZ


class SimulatedRover:
    """Device of a car with an ArduPilot rover.

    Full throttle is the robot's `full_speed`, neutral brakes with `braking`.

    After `boot` seconds its EKF has a position and it can be armed."""

    def __init__(self, body: CarBody, context: DeviceContext, port: Port | None = None) -> None:
        self._body, self._settings = body, decode(context.settings)
        self._frame = LocalFrame(*context.origin)
        boot = context.harness.get("boot", 3.0)
        self._boot = float(boot) if isinstance(boot, (int, float)) else 42.0
        self._mavlink = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self._mavlink.robust_parsing = True
        self._now = 0.0
        self._override: dict[int, tuple[int, float]] = {}  # channel -> value and time of arrival
        self.mode, self.armed = HOLD, False
        makers = {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: self._heartbeat,
            mavlink.MAVLINK_MSG_ID_SYS_STATUS: self._status,
            mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: self._ekf,
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._position,
            mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: self._version,
            mavlink.MAVLINK_MSG_ID_RC_CHANNELS: self._sticks,
        }
        self.parameters = SimulatedParameters(table=PARAMETERS)
        self.texts: list[tuple[int, str]] = []
        self._telemetry = SimulatedTelemetry(makers, {mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0}, self.texts, self._send)
        self.overrides: Mapping[str, Any] = {}
        if port is None:
            port = context.wiring.port()
            self.overrides = {"drive": f"rover:udpin:127.0.0.1:{port.number}"}
        self._port = port

    def step(self, now: float) -> None:
        """See Device."""
        self._now = now
        for datagram in self._port.receive():
            for message in self._mavlink.parse_buffer(bytearray(datagram)) or ():
                self._handle(message, now)
        self._drive(now)
        self._telemetry.step(now)

    def close(self) -> None:
        """See Device."""
        self._port.close()

    def stick(self, channel: int, now: float) -> float:
        """Return the position of a channel's stick, -1 to 1 (RC_Channel::pwm_to_angle_dz)."""
        value, came = self._override.get(channel, (MIDDLE, now))
        if now - came > self.parameters.of("RC_OVERRIDE_TIME"):
            return 0.0
        off = max(MIDDLE - END, min(END - MIDDLE, value - MIDDLE))
        beyond = max(0, abs(off) - DEAD_ZONE)
        return math.copysign(beyond / (END - MIDDLE - DEAD_ZONE), off)

    def _drive(self, now: float) -> None:
        driven = self.armed and self.mode == MANUAL
        steering = -self.stick(1, now) * self._settings.max_steering if driven else 0.0
        throttle = self.stick(3, now) if driven else 0.0
        self._body.drive(throttle * self._settings.full_speed, steering)
        if throttle == 0.0:
            self._body.brake(self._settings.braking)

    def _handle(self, message: Message, now: float) -> None:
        if getattr(message, "target_system", 1) not in (0, 1):
            return
        match message.get_msgId():
            case mavlink.MAVLINK_MSG_ID_RC_CHANNELS_OVERRIDE if message.get_srcSystem() == GROUND_STATION:
                for channel in (1, 3):
                    value = getattr(message, f"chan{channel}_raw")
                    if value == 0:  # back to the receiver; there is none
                        self._override.pop(channel, None)
                    elif value != 65535:
                        self._override[channel] = (value, now)
            case mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ:
                if (value_message := self.parameters.value_message(message.param_id, message.param_index)) is not None:
                    self._send(value_message)  # an unknown parameter is not answered
            case mavlink.MAVLINK_MSG_ID_COMMAND_LONG:
                result = self._execute(message, now)
                self._send(mavlink.MAVLink_command_ack_message(message.command, result))

    def _execute(self, message: Message, now: float) -> int:
        accepted, failed = int(mavlink.MAV_RESULT_ACCEPTED), int(mavlink.MAV_RESULT_FAILED)
        match message.command:
            case mavlink.MAV_CMD_DO_SET_MODE:
                if int(message.param2) not in MODES:
                    return failed
                if now > MODE_LOST:
                    self.mode = int(message.param2)
                return accepted
            case mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
                if message.param1 and now < self._boot:
                    self.texts.append((mavlink.MAV_SEVERITY_CRITICAL, "Arm: Need Position Estimate"))
                    return failed
                self.armed = bool(message.param1)
                return accepted
            case mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
                return self._telemetry.ask(int(message.param1), message.param2, now)
            case mavlink.MAV_CMD_REQUEST_MESSAGE:
                return self._telemetry.once(int(message.param1), now)
        return int(mavlink.MAV_RESULT_UNSUPPORTED)

    def _send(self, message: Message) -> None:
        frame = message.pack(self._mavlink)
        self._mavlink.seq = (self._mavlink.seq + 1) % 256
        self._port.send(frame)

    def _heartbeat(self, now: float) -> Message:
        armed = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_GROUND_ROVER,
            mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
            mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | armed,
            self.mode,
            mavlink.MAV_STATE_ACTIVE if self.armed else mavlink.MAV_STATE_STANDBY,
            3,
        )

    def _status(self, now: float) -> Message:
        rest = (0,) * 6
        return mavlink.MAVLink_sys_status_message(0, 0, 0, 0, round(SUPPLY * 1000), 100, 90, *rest)

    def _ekf(self, now: float) -> Message:
        flags = _KNOWS if now >= self._boot else mavlink.EKF_CONST_POS_MODE
        return mavlink.MAVLink_ekf_status_report_message(flags, 0.0, 0.0, 0.0, 0.0, 0.0)

    def _position(self, now: float) -> Message:
        known = now >= self._boot
        state = self._body.state()
        latitude, longitude, altitude = self._frame.geodetic(*state.position) if known else (0.0, 0.0, 0.0)
        east, north, _ = state.velocity
        return mavlink.MAVLink_global_position_int_message(
            round(now * 1000), round(latitude * 1e7), round(longitude * 1e7), round(altitude * 1e3), 0,
            round(north * 100), round(east * 100), 0, round(math.degrees(math.pi / 2 - state.yaw) * 100) % 36000,
        )  # fmt: skip

    def _version(self, now: float) -> Message:
        nothing = bytes(8)
        return mavlink.MAVLink_autopilot_version_message(0, VERSION, 0, 0, 0, nothing, nothing, nothing, 0, 0, 0)

    def _sticks(self, now: float) -> Message:
        """Report no channels: there is no receiver."""
        return mavlink.MAVLink_rc_channels_message(round(now * 1000), 0, *[0] * 18, 255)
