"""Simulated copter autopilot (ArduPilot or PX4).

Talks MAVLink 2 to an agent and flies a simulated body."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from koordgen.runtime.values.geodesy import LocalFrame
from targets.sim.autopilots.mavlink_copter import ACCEPTED, SPOOL_UP, UNSUPPORTED, Copter
from targets.sim.autopilots.mavlink_estimate import SimulatedEstimator
from targets.sim.autopilots.mavlink_params import DEVELOPMENT, VERSION, SimulatedParameters
from targets.sim.autopilots.mavlink_px4 import STREAMS, Px4, Px4Parameters, Px4Reports
from targets.sim.autopilots.mavlink_reports import Reports
from targets.sim.autopilots.mavlink_setpoints import handle_setpoint, reposition
from targets.sim.autopilots.mavlink_telemetry import Message, SimulatedTelemetry
from targets.sim.base.bodies import DeviceContext, Quadrotor
from targets.sim.base.fault_state import FaultState
from targets.sim.base.ports import Port
from targets.sim.base.scenario import BadScenario

REAL_BOOT = 42.0  # seconds of a cold start, as measured on a real autopilot
SPIN = math.radians(60)  # rad/s, as measured on a build with the fault that `Copter.spins` describes
_SETPOINTS = (
    mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT,
    mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED,
)
_HEARTBEATS = {mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0}  # Hz


class SimulatedAutopilot:
    """Device that stands in for an ArduPilot or PX4 autopilot.

    Settings of the fleet file under the simulator: `boot` (seconds, or "real"), `spool_up` (s, ArduPilot only),
    `firmware`, `version` (of ArduPilot; decides the names of parameters), `position_noise` (m, standard deviation of an
    error that wanders, as the error of a real estimate does). The parameters are preset for the robot's own setting
    `positioning`; without a GPS of its own, the autopilot relies on the positions that it receives. `copter` is the
    inner state, which tests and scenarios may change."""

    def __init__(self, body: Quadrotor, context: DeviceContext, port: Port | None = None) -> None:
        self._body = body
        self._frame = LocalFrame(*context.origin)
        self._mavlink = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self._mavlink.robust_parsing = True
        self._last: float | None = None
        self._dead = False  # true once its process has aborted: it is silent and gives no thrust
        self.dropped = 0  # datagrams and messages that were damaged or addressed to another system
        harness = context.harness
        boot = harness.get("boot", 3.0)
        boot = REAL_BOOT if boot == "real" else _seconds("boot", boot, 600.0, ", or `real`")
        positioning = str(context.settings.get("positioning", ""))
        params = SimulatedParameters(_version(str(harness.get("version", VERSION))), positioning=positioning)
        firmware = str(harness.get("firmware", "ardupilot"))
        spool_up = _seconds("spool_up", harness.get("spool_up", SPOOL_UP), 10.0)
        self.copter, self._reports, streams = self._firmware(firmware, boot, spool_up, params, context.fault_state)
        noise, seed = float(harness.get("position_noise", 0.0)), f"{context.seed}/{context.robot}/autopilot"
        self.copter.estimator = self._estimator = SimulatedEstimator(
            params,
            self._frame,
            boot,
            noise,
            seed,
            self.copter.report_text,
            context.fault_state,
            self.copter.resets_datum,
        )
        self._parameters_to_send: deque[str] = deque()  # parameters still to be sent for PARAM_REQUEST_LIST
        self._telemetry = SimulatedTelemetry(self._reports.makers, streams, self.copter.texts, self._send)
        self.overrides: Mapping[str, Any] = {}
        if port is None:
            port = context.wiring.port()
            self.overrides = {"autopilot": f"udpin:127.0.0.1:{port.number}"}
        self._port = port

    def _firmware(
        self, name: str, boot: float, spool_up: float, params: SimulatedParameters, fault_state: FaultState
    ) -> tuple[Copter, Reports, Mapping[int, float]]:
        """Return the state machine of a firmware, its reports, and its default stream rates.

        Raises BadScenario."""
        if name == "ardupilot":
            copter = Copter(boot, params, spool_up)
            return copter, Reports(copter, self._frame, fault_state), _HEARTBEATS
        if name == "px4":
            px4 = Px4(boot, Px4Parameters(params.positioning), self._frame)
            return px4, Px4Reports(px4, self._frame, fault_state), STREAMS
        raise BadScenario(f"firmware is {name!r}", "there are: ardupilot, px4")

    def step(self, now: float) -> None:
        """See Device."""
        if self._dead:
            self._port.receive()
            return
        dt = 0.0 if self._last is None else max(0.0, min(now - self._last, 0.1))
        self._last = now
        self._estimator.step(self._body.state(), now, dt)
        if self._receive(now):
            self._fly(now, dt)
            if self._parameters_to_send:
                self._answer_param(self._parameters_to_send.popleft())
            self._telemetry.step(now)

    def close(self) -> None:
        """See Device."""
        self._port.close()

    def _receive(self, now: float) -> bool:
        """Handle all received messages. Return False once the autopilot has aborted."""
        for datagram in self._port.receive():
            for message in self._decoded(datagram):
                self._handle(message, now)
        return not self._dead

    def _fly(self, now: float, dt: float) -> None:
        copter, estimate = self.copter, self._estimator.estimate
        copter.volts = self._reports.volts
        copter.watch(now)
        self._body.motors(copter.armed)
        if not copter.armed:
            return
        guidance = copter.guidance
        if copter.landed:
            guidance.idle()
            self._body.accelerate((0.0, 0.0, -1.0), 0.0)  # motors idle on the ground
        elif dt > 0.0:
            acceleration = guidance.acceleration(estimate.position, estimate.velocity, now, dt)
            turning = guidance.turning(estimate.yaw, dt)
            self._body.accelerate(acceleration, SPIN if copter.spins else turning)

    def _decoded(self, datagram: bytes) -> list[Message]:
        self._mavlink.buf.clear()
        self._mavlink.buf_index = 0
        try:
            messages = self._mavlink.parse_buffer(datagram) or []
        except Exception:  # pymavlink's generated code may raise anything on hostile bytes
            self.dropped += 1
            return []
        good = [m for m in messages if m.get_msgId() >= 0]
        self.dropped += len(messages) - len(good)
        return good

    def _send(self, message: Message) -> None:
        self._port.send(message.pack(self._mavlink))
        self._mavlink.seq = (self._mavlink.seq + 1) % 256

    def _handle(self, message: Message, now: float) -> None:
        if getattr(message, "target_system", 0) not in (0, 1):
            self.dropped += 1
            return
        match message.get_msgId():
            case mavlink.MAVLINK_MSG_ID_HEARTBEAT:
                self.copter.heard_heartbeat(message.get_srcSystem(), now)
            case mavlink.MAVLINK_MSG_ID_COMMAND_LONG | mavlink.MAVLINK_MSG_ID_COMMAND_INT:
                self._send(
                    mavlink.MAVLink_command_ack_message(
                        message.command, self._command(message, now), 0, 0,
                        message.get_srcSystem(), message.get_srcComponent(),
                    )
                )  # fmt: skip
            case number if number in _SETPOINTS:
                if not handle_setpoint(message, self.copter, self._frame, now):
                    self._dead = True
                    self._body.motors(False)
            case _:
                self._handle_positioning(message, now)
                self._handle_parameter(message)

    def _handle_positioning(self, message: Message, now: float) -> None:
        match message.get_msgId():
            case mavlink.MAVLINK_MSG_ID_GPS_INPUT:
                self._estimator.receive_gps(message, now)
            case mavlink.MAVLINK_MSG_ID_VISION_POSITION_ESTIMATE:
                self._estimator.receive_vision((message.x, message.y, message.z), message.yaw, now)
            case mavlink.MAVLINK_MSG_ID_ODOMETRY:
                known = message.frame_id in self.copter.odometry_frames
                if known and message.child_frame_id == mavlink.MAV_FRAME_BODY_FRD:
                    w, x, y, z = message.q
                    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
                    self._estimator.receive_vision((message.x, message.y, message.z), yaw, now)
            case mavlink.MAVLINK_MSG_ID_SET_GPS_GLOBAL_ORIGIN:
                self._estimator.receive_origin(message)

    def _handle_parameter(self, message: Message) -> None:
        match message.get_msgId():
            case mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ:
                self._answer_param(message.param_id, message.param_index)
            case mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_LIST:
                self._parameters_to_send.extend(self.copter.params)
            case mavlink.MAVLINK_MSG_ID_PARAM_SET:
                if self.copter.params.change(message.param_id, message.param_value):
                    self._answer_param(message.param_id)

    def _answer_param(self, name: str, index: int = -1) -> None:
        """Send a PARAM_VALUE. An unknown parameter is not answered, as on a real autopilot."""
        value_message = self.copter.params.value_message(name, index)
        if value_message is not None:
            self._send(value_message)

    def _command(self, message: Message, now: float) -> int:
        """Execute a command and return its MAV_RESULT."""
        if message.get_msgId() == mavlink.MAVLINK_MSG_ID_COMMAND_INT:
            if message.command == mavlink.MAV_CMD_DO_REPOSITION:
                return reposition(message, self.copter, self._frame, now)
            message.param7 = message.z
        p1, p2 = message.param1, message.param2
        match message.command:
            case mavlink.MAV_CMD_SET_MESSAGE_INTERVAL if math.isfinite(p1):
                return self._telemetry.ask(int(p1), p2, now)
            case mavlink.MAV_CMD_REQUEST_MESSAGE if math.isfinite(p1):
                return self._telemetry.once(int(p1), now)
            case mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
                self._telemetry.once(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION, now)
                return ACCEPTED
        result = self.copter.command(message, now)
        return UNSUPPORTED if result is None else result


def _version(text: str) -> str:
    """Return the setting `version` after a check. Raises BadScenario."""
    major, _, minor = text.removesuffix(DEVELOPMENT).partition(".")
    if not (major.isdecimal() and minor.isdecimal()):
        raise BadScenario(f"version is {text!r}", "give ArduPilot's major and minor version, such as 4.7 or 4.7-dev")
    return text


def _seconds(name: str, value: Any, most: float, words: str = "") -> float:
    """Return a setting in seconds, 0 to `most`. Raises BadScenario."""
    try:
        seconds = float(value)
    except ValueError:
        seconds = -1.0
    if not 0.0 <= seconds <= most:
        raise BadScenario(f"{name} is {value!r}", f"give seconds, 0 to {most:g}{words}")
    return seconds
