"""Drive of a car with an ArduPilot rover: steering and throttle in MANUAL mode, by overriding two RC channels.

The mode is MANUAL and not GUIDED, because only MANUAL sets the wheels to the angle that the agent's controller
commands, also at standstill. The agent controls the speed by the throttle.

The rover accepts overrides only from MAVLink system 255. An override holds for 3 s after the last message, so neutral
is sent until the car stands.

If a pilot or a failsafe changes the mode or disarms, the agent does not take the rover back: it releases the overrides,
and the pilot's sticks control the rover.
"""

from __future__ import annotations

import math
from typing import Protocol

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from koordgen.runtime.values.geodesy import LocalFrame
from koordgen.runtime.values.points import Point, Pose
from koordgen.runtime.vehicle.platform import Finding, Unready
from targets.car.base.settings import CarSettings
from targets.car.control.mpc import STEP, Command
from targets.car.drive import battery, rover_parameters
from targets.car.drive.throttle import NEUTRAL, SpeedLoop, channel
from targets.car.drive.watched import Watch
from targets.mavlink.framing import Message
from targets.mavlink.link import GROUND_STATION, Link
from targets.mavlink.parameters import Parameters
from targets.mavlink.transport import Transport, Way

MANUAL = 0  # custom_mode of MANUAL
STARTING = 60.0  # seconds to wait for the first message: a rover may be switched on after the agent
SILENT, LOST = 1.5, 5.0  # seconds without a message after which the car is braked, or the rover counts as lost
RELEASE, LEAVE = 0, 65535  # values of an override: give the channel back to the receiver, leave it unchanged
STAYS_ARMED = "a rover whose agent was killed stays armed: keep away from its wheels, and disarm it by a ground station"
_RATES = {
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 20.0,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 2.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
}  # message id -> requested rate in Hz
_VOUCHED = 2.0  # seconds for which an EKF status report counts as current
_ARDUPILOT = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
_ROVERS = (mavlink.MAV_TYPE_GROUND_ROVER, mavlink.MAV_TYPE_SURFACE_BOAT)


class ConsoleTransport(Transport, Protocol):
    """MAVLink transport on which the agent and the watchdog's process can write."""

    def way(self) -> Way | None: ...


class RoverDrive:
    """Drive with an ArduPilot rover: implements `drive.Drive`. `frame`: the fleet's local frame."""

    def __init__(self, settings: CarSettings, transport: ConsoleTransport, watch: Watch, frame: LocalFrame) -> None:
        self._settings, self._transport, self._watch, self._frame = settings, transport, watch, frame
        self._link = Link(transport)
        self._loop = SpeedLoop(settings.full_speed)
        self._held: Way | None = None
        self._mode: int | None = None
        self._armed = False
        self._ours = self._was_armed = False  # whether the rover was seen in MANUAL; whether it was armed there
        self._taken = ""  # reason why the rover is under another's control, in words; or ""
        self.asked = 0.0  # speed (m/s) that the last throttle should give
        self._volts: float | None = None
        self.battery: float | None = None  # charge, 0 to 1; None: unknown
        self._version = ""
        self._vouched = -math.inf  # time of the last EKF report, if it shows an absolute position; else -inf
        self._fixes: list[tuple[Pose, float]] = []
        self._asked: dict[int, float] = {}
        self._came: dict[int, float] = {}
        self._begun: float | None = None
        self._now = 0.0
        self._log_lines: list[str] = []
        self._parameters: Parameters | None = None  # the rover's parameters; they are read only for a pre-flight check
        self._receiver: bool | None = None  # whether the rover receives signals of a remote control
        self._sticks_asked = -math.inf

    @property
    def heard(self) -> bool:
        return self._link.vehicle is not None and self._volts is not None and bool(self._version)

    @property
    def fault(self) -> str:
        return ""

    @property
    def about(self) -> str:
        if not self.heard:
            return "a rover that does not report its version"
        return f"ArduPilot rover {self._version} answers on {self._settings.drive}, supply {self._volts:.1f} V"

    @property
    def doubt(self) -> str:
        if self._link.rivalled(self._now):
            return "another ground station uses system id 255: its overrides would drive the car, too"
        return battery.doubt(self._volts or 0.0)

    @property
    def blocked(self) -> str:
        if self._link.vehicle is None:
            return f"waiting for a heartbeat on {self._settings.drive}"
        if self._silence > SILENT:
            return f"braking: nothing has come from the rover for {self._silence:.1f} s"
        if self._link.crowded(self._now):
            return "braking: two autopilots send on this link"
        if self._taken or not self.heard:
            return self._taken or "waiting for the rover's version and status"
        if not self._ours or not self._armed:
            said = self._link.reasons(self._now - 10.0)
            return ("arming" if self._ours else "changing to MANUAL") + (f": {said}" if said else "")
        return self._watch.trouble

    @property
    def _is_rover(self) -> bool:
        vehicle = self._link.vehicle
        return vehicle is not None and vehicle.type in _ROVERS and vehicle.autopilot == _ARDUPILOT

    @property
    def _silence(self) -> float:
        since = self._begun if self._link.spoke is None else self._link.spoke
        return 0.0 if since is None else self._now - since

    def read(self, now: float) -> float | None:
        """Implement `Drive.read`."""
        self._now = now
        self._begun = now if self._begun is None else self._begun
        self._watch.poll()
        speed = None
        for message in self._link.receive(now):
            self._came[message.get_msgId()] = now
            speed = self._receive(message, now) if message.get_msgId() in _RATES else speed
            self._note(message)
            if self._parameters is not None:
                self._parameters.handle(message)
        self._link.greet(now)
        vehicle = self._link.vehicle
        if vehicle is not None and not self._is_rover:
            raise Unready(
                f"the vehicle that answers on {self._settings.drive} is not an ArduPilot rover", "correct `drive`"
            )
        self._hand_over()
        if self._silence > (STARTING if vehicle is None else LOST):
            hint = "check its supply and cable; the rover drives on for 3 s after the last override, then goes neutral"
            raise Unready(f"nothing has come from {self._settings.drive} for {self._silence:.1f} s", hint)
        return speed

    def _note(self, message: Message) -> None:
        match message.get_msgId():
            case mavlink.MAVLINK_MSG_ID_HEARTBEAT:
                self._mode = message.custom_mode
                self._armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
                self._watch_pilot()
            case mavlink.MAVLINK_MSG_ID_RC_CHANNELS:
                self._receiver = message.chancount > 0
            case mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
                number = message.flight_sw_version
                self._version = f"{number >> 24}.{number >> 16 & 255}.{number >> 8 & 255}"

    def _receive(self, message: Message, now: float) -> float | None:
        """Process a streamed message. Return the EKF's signed speed (m/s), or None if the message has no speed."""
        match message.get_msgId():
            case mavlink.MAVLINK_MSG_ID_SYS_STATUS:
                self._volts = 0.0 if message.voltage_battery == 65535 else message.voltage_battery / 1000
                known = 0 <= message.battery_remaining <= 100  # percent; -1: unknown
                self.battery = message.battery_remaining / 100 if known else None
            case mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT:
                knows = message.flags & mavlink.EKF_POS_HORIZ_ABS and not message.flags & mavlink.EKF_CONST_POS_MODE
                self._vouched = now if knows else -math.inf
            case mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT if self._settings.position == "rover":
                return self._fix(message, now)
        return None

    def _fix(self, message: Message, now: float) -> float | None:
        if now - self._vouched > _VOUCHED or message.hdg >= 36000 or (message.lat == 0 and message.lon == 0):
            return None
        latitude, longitude = message.lat * 1e-7, message.lon * 1e-7
        x, y, _ = self._frame.enu(latitude, longitude, message.alt * 1e-3)
        yaw = math.remainder(math.pi / 2 - math.radians(message.hdg / 100), math.tau)
        self._fixes.append((Pose(Point(x, y, 0.0), yaw), now))
        vx, vy, _ = self._frame.turned(latitude, longitude, message.vx * 0.01, message.vy * 0.01, 0.0)
        return vx * math.cos(yaw) + vy * math.sin(yaw)

    def checks(self, now: float) -> list[Finding] | None:
        """Check the parameters that `rover_parameters` lists, and that the rover is disarmed."""
        if self._parameters is None:
            asked = rover_parameters.rules(self._settings, receiver=False)
            self._parameters = Parameters(tuple(rule.wanted for rule in asked), bytewise=False)
        self._parameters.poll(self._link, now)
        if self._receiver is None and now - self._sticks_asked >= 1.0 and self._link.vehicle is not None:
            self._sticks_asked = now
            self._link.send_once(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_RC_CHANNELS)
        if not self._parameters.done(now):
            return None
        armed = [Finding("state", "warn", "armed", "disarmed", STAYS_ARMED)] if self._armed else []
        return [*armed, *rover_parameters.checks(self._settings, self._receiver, self._parameters.readings)]

    def fixes(self) -> list[tuple[Pose, float]]:
        """Implement `Drive.fixes`."""
        found, self._fixes = self._fixes, []
        return found

    def _watch_pilot(self) -> None:
        """Release the rover if somebody else, or a failsafe, has changed its mode or disarmed it."""
        if self._taken or not self._ours:
            return
        if self._mode != MANUAL:
            self._taken = f"braking: somebody has changed the rover to mode {self._mode}, and controls it"
        elif self._was_armed and not self._armed:
            self._taken = "braking: somebody, or the rover itself, has disarmed the rover; it stays disarmed"
        if self._taken:
            self._log_lines.append(self._taken.removeprefix("braking: "))
            self._watch.release()
            self._held = None

    def _hand_over(self) -> None:
        """Pass the transport's descriptor to the watchdog whenever it changes."""
        way = self._transport.way()
        if way == self._held or self._taken or self._link.vehicle is None:
            return
        self._held = way
        if way is None:
            self._watch.release()
        else:
            packer = mavlink.MAVLink(None, srcSystem=GROUND_STATION, srcComponent=mavlink.MAV_COMP_ID_MISSIONPLANNER)
            self._watch.hold(way.descriptor, self._override(NEUTRAL, NEUTRAL).pack(packer), way.address)

    def _override(self, steering: int, throttle: int) -> Message:
        vehicle = self._link.vehicle
        assert vehicle is not None
        rest = [LEAVE] * 5
        return mavlink.MAVLink_rc_channels_override_message(
            vehicle.system, vehicle.component, steering, LEAVE, throttle, *rest
        )

    def ask(self, now: float) -> None:
        """Request missing messages, because the rover streams messages only on request."""
        if self._link.vehicle is None:
            return
        for number, rate in _RATES.items():
            missing = now - self._came.get(number, -math.inf) > 1.5
            if missing and now - self._asked.get(number, -math.inf) >= 1.0:
                self._asked[number] = now
                self._link.send_once(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1e6 / rate)
        if not self._version:
            self._link.ask(now, mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)

    def _prepare(self, now: float) -> None:
        """Switch the rover to MANUAL, then arm it once.

        Only a heartbeat proves the mode: in the first second after boot, the rover acknowledges a mode but drops it."""
        if self._taken or not self.heard:
            return
        if not self._ours:
            self._ours = self._mode == MANUAL
            if not self._ours:
                custom = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
                self._link.ask(now, mavlink.MAV_CMD_DO_SET_MODE, custom, MANUAL)
        elif not self._armed:
            self._link.ask(now, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, every=2.0)
        elif not self._was_armed:
            self._was_armed = True
            self._log_lines.append("the rover is armed; it stays armed if this agent is killed")

    def go(self, command: Command, speed: float | None, now: float) -> None:
        """Implement `Drive.go`."""
        # Negated, because channel values above 1500 turn the wheels to the right.
        steering = channel(-command.steering / self._settings.max_steering)
        throttle = self._loop.throttle(command.speed, speed, STEP)
        self.asked = throttle * self._settings.full_speed
        self._send(steering, channel(throttle), now)

    def brake(self, now: float) -> None:
        """Command neutral throttle and straight wheels."""
        self._loop.reset()
        self._send(NEUTRAL, NEUTRAL, now)

    def _send(self, steering: int, throttle: int, now: float) -> None:
        if not self._is_rover:
            return
        self.ask(now)
        self._prepare(now)
        if self._taken:
            self._link.send(self._override(RELEASE, RELEASE))
            return
        unsent = self._link.unsent
        self._link.send(self._override(steering, throttle))
        if self._link.unsent == unsent:
            self._watch.beat()

    def log_lines(self) -> list[str]:
        """Implement `Drive.log_lines`."""
        told, self._log_lines = self._log_lines + self._watch.log_lines(), []
        return told

    def close(self, standing: bool) -> None:
        """Close the links. First disarm a standing rover that this agent armed, unless somebody else controls it."""
        if self._was_armed and standing and not self._taken:
            self._link.send(self._override(NEUTRAL, NEUTRAL))
            for _ in range(3):  # the command is repeated, because the agent cannot see after `close` whether it arrived
                self._link.send_once(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)
            self._was_armed = False
        self._watch.close(standing)
        self._link.close()
