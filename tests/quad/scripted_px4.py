"""A PX4 as far as the agent's client sees it: streams on request, OFFBOARD as long as setpoints come, AUTO landing."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from koordgen.runtime.geodesy import LocalFrame
from targets.quad.framing import Framer, Message
from tests.quad.rig import ORIGIN, PointMass

POSITION, OFFBOARD, LAND = 3 << 16, 6 << 16, 4 << 16 | 6 << 24
ESTIMATING = 0x33F  # attitude, velocity, position: relative, absolute and predicted
ACCEPTED, REJECTED = mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_TEMPORARILY_REJECTED


class ScriptedPx4:
    """Stands where the rig has its autopilot. `params` are integers, sent bytewise."""

    def __init__(self, body: PointMass, port: Any) -> None:
        self._body, self._port = body, port
        self._packer, self._framer = mavlink.MAVLink(None, 1, 1), Framer()
        self._frame = LocalFrame(*ORIGIN)
        self._due: dict[int, list[float]] = {0: [0.0, 1.0]}  # message -> when, how often
        self._setpoints: list[float] = []  # when they came
        self._still: float | None = None
        self._boot: float | None = None
        self.target: tuple[float, float, float] | None = None
        self.params = {"COM_OBL_RC_ACT": 4, "COM_RCL_EXCEPT": 4}
        self.floats = {"COM_OF_LOSS_T": 1.0}
        self.mode, self.armed, self.landed = POSITION, False, True
        self.refused = ""  # words against arming
        self.modes: list[int] = []  # that were taken

    def step(self, now: float) -> None:
        self._boot = now if self._boot is None else self._boot
        for datagram in self._port.receive():
            for message in self._framer.datagram(datagram):
                self._take(message, now)
        if self.mode == OFFBOARD and now - self._setpoints[-1] > 1.0:
            self.enter(LAND)
        self._fly(now)
        for message_id, (when, every) in self._due.items():
            if now >= when:
                self._due[message_id][0] = now + every
                self._tell(message_id, now)

    def close(self) -> None:
        pass

    def enter(self, mode: int) -> None:
        self.mode = mode
        self.modes.append(mode)
        if mode != OFFBOARD:
            self.target = self._body.state().position

    def _streaming(self, now: float) -> bool:
        """Faster than 2 Hz for the last second."""
        times = [t for t in self._setpoints if t > now - 1.0]
        return len(times) > 2 and now - times[0] > 0.9 and now - times[-1] < 0.5

    def _fly(self, now: float) -> None:
        self._body.motors(self.armed)
        position, velocity = self._body.state().position, self._body.state().velocity
        x, y, z = self.target or position
        if not self.armed or self.landed:
            self._body.accelerate((0.0, 0.0, -1.0), 0.0)
            self.landed = not (self.armed and self.mode == OFFBOARD and z > position[2])
            return
        down = self.mode == LAND
        vz = -0.5 if down else max(-1.0, min(3.0, z - position[2]))
        wanted = (max(-5.0, min(5.0, x - position[0])), max(-5.0, min(5.0, y - position[1])), vz)
        ax, ay, az = (2 * (w - v) for w, v in zip(wanted, velocity, strict=True))
        self._body.accelerate((ax, ay, az), 0.0)
        self._still = now if self._still is None or not down or position[2] > 0.01 else self._still
        if down and now - self._still > 1.0:
            self.landed, self.armed = True, False

    def _take(self, message: Message, now: float) -> None:
        match message.get_msgId():
            case mavlink.MAVLINK_MSG_ID_COMMAND_LONG:
                result = self._command(message, now)
                self._send(mavlink.MAVLink_command_ack_message(message.command, result, 0, 0, 255, 190))
            case mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT:
                assert message.coordinate_frame == mavlink.MAV_FRAME_GLOBAL_INT and math.isfinite(message.alt)
                self._setpoints.append(now)
                if self.mode == OFFBOARD:
                    place = (message.lat_int * 1e-7, message.lon_int * 1e-7, message.alt)
                    self.target = self._frame.enu(*place)
            case mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ:
                self._answer(message.param_id)

    def _command(self, message: Message, now: float) -> int:
        match message.command:
            case mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
                self._due[int(message.param1)] = [now, message.param2 * 1e-6]
            case mavlink.MAV_CMD_DO_SET_MODE:
                mode = int(message.param2) << 16 | int(message.param3) << 24
                if message.param1 != 1 or (mode == OFFBOARD and not self._streaming(now)):
                    return int(REJECTED)
                self.enter(mode)
            case mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
                if message.param1 and self.refused:
                    self._send(mavlink.MAVLink_statustext_message(2, self.refused.encode()))
                    return int(REJECTED)
                if not message.param1 and not self.landed:
                    return int(REJECTED)
                self.armed = bool(message.param1)
            case _:
                return int(mavlink.MAV_RESULT_UNSUPPORTED)
        return int(ACCEPTED)

    def _answer(self, name: str) -> None:
        if name in self.params:
            value = struct.unpack("<f", struct.pack("<i", self.params[name]))[0]
            kind = mavlink.MAV_PARAM_TYPE_INT32
        elif name in self.floats:
            value, kind = self.floats[name], mavlink.MAV_PARAM_TYPE_REAL32
        else:
            return
        self._send(mavlink.MAVLink_param_value_message(name.encode(), value, kind, 900, 65535))

    def _tell(self, message_id: int, now: float) -> None:
        maker: Callable[[int], Message] | None = {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: self._heartbeat,
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._global,
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self._local,
            mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: self._state,
            mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: self._estimator,
            mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: self._target,
        }.get(message_id)
        if maker is not None and (message_id == 0 or now - (self._boot or 0.0) > 1.0):
            self._send(maker(1 + round((now - (self._boot or 0.0)) * 1000)))

    def _heartbeat(self, clock: int) -> Message:
        flags = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0)
        return mavlink.MAVLink_heartbeat_message(2, mavlink.MAV_AUTOPILOT_PX4, flags, self.mode, 4, 3)

    def _global(self, clock: int) -> Message:
        latitude, longitude, altitude = self._frame.geodetic(*self._body.state().position)
        vx, vy, vz = (round(v * 100) for v in self._body.state().velocity)
        place = (round(latitude * 1e7), round(longitude * 1e7), round(altitude * 1e3))
        return mavlink.MAVLink_global_position_int_message(clock, *place, 0, vy, vx, -vz, 9000)

    def _local(self, clock: int) -> Message:
        return mavlink.MAVLink_local_position_ned_message(clock, *self._own(self._body.state().position), 0, 0, 0)

    def _state(self, clock: int) -> Message:
        landed = mavlink.MAV_LANDED_STATE_ON_GROUND if self.landed else mavlink.MAV_LANDED_STATE_IN_AIR
        return mavlink.MAVLink_extended_sys_state_message(0, landed)

    def _estimator(self, clock: int) -> Message:
        return mavlink.MAVLink_estimator_status_message(clock, ESTIMATING, *[0.0] * 8)

    def _target(self, clock: int) -> Message:
        own = self._own(self.target or self._body.state().position)
        return mavlink.MAVLink_position_target_local_ned_message(clock, 1, 0, *own, *[0.0] * 8)

    def _own(self, p: tuple[float, float, float]) -> tuple[float, float, float]:
        """NED about an origin of its own."""
        return p[1] + 7.0, p[0] - 3.0, -p[2] + 0.5

    def _send(self, message: Message) -> None:
        self._port.send(message.pack(self._packer))
