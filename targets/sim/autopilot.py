"""A simulated ArduPilot copter: speaks MAVLink 2 to a robot's agent and flies a body, as observed on the real one."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from koordgen.runtime.geodesy import LocalFrame
from targets.sim.bodies import BodyState, DeviceContext, Quadrotor
from targets.sim.mavlink_copter import ACCEPTED, GUIDED, Copter
from targets.sim.mavlink_guided import Vector
from targets.sim.mavlink_setpoints import take_setpoint
from targets.sim.mavlink_telemetry import Estimate, Message, Telemetry
from targets.sim.ports import Port, UdpPort

WANDER = 2.0  # seconds over which the error of the position estimate forgets itself
_SETPOINTS = (
    mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT,
    mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED,
)
_YAW_GAIN, _YAW_RATE = 1.5, 1.0  # rad/s per rad, and at most


class SimulatedAutopilot:
    """A device of the sim harness. Its settings there: `boot` (s), `position_noise` (m, standard deviation of an error
    that wanders, as that of a real estimate does). `copter` is its inner state, for tests and scenarios to upset."""

    def __init__(self, body: Quadrotor, context: DeviceContext, port: Port | None = None) -> None:
        self._body = body
        self._frame = LocalFrame(*context.origin)
        self._noise = float(context.harness.get("position_noise", 0.0))
        self._random = random.Random(f"{context.seed}/{context.robot}/autopilot")
        self._error: Vector = (0.0, 0.0, 0.0)
        self._mavlink = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self._mavlink.robust_parsing = True
        self._estimate = Estimate()
        self._last: float | None = None
        self._dead = False  # its process has aborted: silence, and no thrust
        self.dropped = 0  # datagrams and messages that were damaged or not for us
        self.copter = Copter(float(context.harness.get("boot", 3.0)))
        self._telemetry = Telemetry(self.copter, self._frame, self._send)
        self.overrides: Mapping[str, Any] = {}
        if port is None:
            port = udp = UdpPort()
            self.overrides = {"autopilot": f"udpin:127.0.0.1:{udp.number}"}
        self._port = port

    def step(self, now: float) -> None:
        """See Device."""
        if self._dead:
            self._port.receive()
            return
        if self.copter.started is None:
            self.copter.started = now
        dt = 0.0 if self._last is None else max(0.0, min(now - self._last, 0.1))
        self._last = now
        self._observe(self._body.state(), dt)
        if self._telemetry.ekf is None and self.copter.estimating(now):
            self._initialise()
        if self._receive(now):
            self._fly(now, dt)
            self._telemetry.step(self._estimate, now)

    def close(self) -> None:
        """See Device."""
        self._port.close()

    def _receive(self, now: float) -> bool:
        """Obey what has come; False when that was the end."""
        for datagram in self._port.receive():
            for message in self._decoded(datagram):
                self._take(message, now)
        return not self._dead

    def _observe(self, truth: BodyState, dt: float) -> None:
        """The estimate is the truth and a first-order Gauss-Markov error."""
        if self._noise:
            keep = math.exp(-dt / WANDER) if dt else 0.0
            fresh = self._noise * math.sqrt(1 - keep * keep)
            x, y, z = self._error
            gauss = self._random.gauss
            self._error = (keep * x + gauss(0, fresh), keep * y + gauss(0, fresh), keep * z + gauss(0, fresh))
        (x, y, z), (a, b, c) = truth.position, self._error
        self._estimate.position = (x + a, y + b, z + c)
        self._estimate.velocity, self._estimate.yaw = truth.velocity, truth.yaw

    def _initialise(self) -> None:
        """The EKF's origin is where the vehicle was when it learned its position: no other robot's."""
        self._telemetry.ekf_place = self._frame.geodetic(*self._estimate.position)
        self._telemetry.ekf = LocalFrame(*self._telemetry.ekf_place)
        self.copter.home = self._estimate.position
        self.copter.say(mavlink.MAV_SEVERITY_INFO, "EKF3 IMU0 origin set")

    def _fly(self, now: float, dt: float) -> None:
        copter = self.copter
        copter.watch(self._estimate.position, self._estimate.velocity, now)
        self._body.motors(copter.armed)
        if not copter.armed:
            return
        if copter.landed:
            copter.guidance.rest()
            self._body.accelerate((0.0, 0.0, -1.0), 0.0)  # idling
            return
        if dt <= 0.0:
            return
        guidance = copter.guidance
        acceleration = guidance.acceleration(self._estimate.position, self._estimate.velocity, now, dt)
        turn = math.remainder(guidance.yaw - self._estimate.yaw, math.tau)
        self._body.accelerate(acceleration, max(-_YAW_RATE, min(_YAW_RATE, _YAW_GAIN * turn)))

    def _decoded(self, datagram: bytes) -> list[Message]:
        self._mavlink.buf.clear()
        self._mavlink.buf_index = 0
        try:
            messages = self._mavlink.parse_buffer(datagram) or []
        except Exception:  # generated code on hostile bytes
            self.dropped += 1
            return []
        good = [m for m in messages if m.get_msgId() >= 0]
        self.dropped += len(messages) - len(good)
        return good

    def _send(self, message: Message) -> None:
        self._port.send(message.pack(self._mavlink))
        self._mavlink.seq = (self._mavlink.seq + 1) % 256

    def _take(self, message: Message, now: float) -> None:
        if getattr(message, "target_system", 0) not in (0, 1):
            self.dropped += 1
            return
        match message.get_msgId():
            case mavlink.MAVLINK_MSG_ID_HEARTBEAT:
                if message.get_srcSystem() == 255:
                    self.copter.ground_station = now
            case mavlink.MAVLINK_MSG_ID_COMMAND_LONG:
                result = self._command(message, now)
                self._send(
                    mavlink.MAVLink_command_ack_message(
                        message.command, result, 0, 0, message.get_srcSystem(), message.get_srcComponent()
                    )
                )
            case number if number in _SETPOINTS:
                self._take_setpoint(message, now)
            case mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ:
                self._answer_param(message.param_id)
            case mavlink.MAVLINK_MSG_ID_PARAM_SET:
                if message.param_id in self.copter.params and math.isfinite(message.param_value):
                    self.copter.params[message.param_id] = message.param_value
                    self._answer_param(message.param_id)

    def _take_setpoint(self, message: Message, now: float) -> None:
        ekf = self._telemetry.ekf
        if ekf is None or self.copter.mode != GUIDED:
            return
        if not take_setpoint(message, self.copter, self._frame, ekf, self._estimate, now):
            self._dead = True
            self._body.motors(False)

    def _answer_param(self, name: str) -> None:
        """An unknown parameter never answers."""
        if name in self.copter.params:
            value, kind = self.copter.params[name], mavlink.MAV_PARAM_TYPE_REAL32
            self._send(mavlink.MAVLink_param_value_message(name.encode(), value, kind, len(self.copter.params), 65535))

    def _command(self, message: Message, now: float) -> int:
        """A MAV_RESULT."""
        p1, p2, p7 = message.param1, message.param2, message.param7
        if not all(map(math.isfinite, (p1, p2, p7))):
            return int(mavlink.MAV_RESULT_DENIED)
        position = self._estimate.position
        match message.command:
            case mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
                return self._telemetry.ask(int(p1), p2, now)
            case mavlink.MAV_CMD_REQUEST_MESSAGE:
                return self._telemetry.once(int(p1), self._estimate, now)
            case mavlink.MAV_CMD_DO_SET_MODE:
                if not int(p1) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
                    return int(mavlink.MAV_RESULT_UNSUPPORTED)
                return self.copter.set_mode(int(p2), position, now)
            case mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
                if p1 == 1:
                    return self.copter.arm(position, self._estimate.yaw, now)
                return self.copter.disarm(force=p2 == 21196)
            case mavlink.MAV_CMD_NAV_TAKEOFF:
                return self.copter.take_off(p7, position, now)
            case mavlink.MAV_CMD_DO_CHANGE_SPEED:
                if not 0.1 <= p2 <= 20 or int(p1) not in (0, 1):
                    return int(mavlink.MAV_RESULT_DENIED)
                self.copter.guidance.speed = p2
                return int(ACCEPTED)
        return int(mavlink.MAV_RESULT_UNSUPPORTED)
