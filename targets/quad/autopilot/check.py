"""Recording of an autopilot's messages for a pre-flight check, which takes some seconds.

The check moves nothing. It requests the messages that the autopilot sends only on request.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from koordgen.runtime.config.settings import Box
from koordgen.runtime.values.geodesy import LocalFrame
from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.platform import Unready
from koordgen.runtime.vehicle.safety import clamp
from targets.mavlink.framing import Message
from targets.mavlink.link import GROUND_STATION, Link
from targets.mavlink.parameters import Parameters, Wanted
from targets.quad.autopilot.firmware import Firmware
from targets.quad.autopilot.telemetry import Streams, Telemetry
from targets.quad.autopilot.vehicles import identified

SILENCE = 5.0  # seconds without any heartbeat after which the check ends; autopilots send one heartbeat per second
DEADLINE = 9.5  # seconds within which the first position estimate must arrive
WATCHED = 3.0  # seconds of recording after the first position estimate, to measure the rates of the message streams
_PAUSE = 0.05  # seconds between two polls of the link
GROUND_SLACK = 0.5  # metres that the robot on the ground may be below the geofence: altitude estimates have errors

# Messages that are requested once a second, because they are not streamed.
SELDOM = (
    mavlink.MAVLINK_MSG_ID_SYS_STATUS,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,
)


@dataclass
class Heard:
    """Record of one autopilot's messages during a check.

    The dictionaries are keyed by MAVLink message id. Times are seconds on the agent's clock, unless stated otherwise.
    """

    link: Link
    telemetry: Telemetry
    first: dict[int, float] = field(default_factory=dict)  # message id -> arrival time of the first message
    last: dict[int, float] = field(default_factory=dict)  # message id -> arrival time of the last message
    count: dict[int, int] = field(default_factory=dict)  # message id -> number of messages after the first
    newest: dict[int, Message] = field(default_factory=dict)  # message id -> last message
    parameters: Parameters | None = None
    wall: float = 0.0  # this computer's time of day (seconds since 1970) when the last SYSTEM_TIME arrived
    began: float = 0.0  # time at which the record started
    ended: float = 0.0  # time at which the record ended
    examined: bool = False  # whether the autopilot was asked to run its pre-arm checks and report them as STATUSTEXT

    def ask(self) -> None:
        """Request the messages that the autopilot does not stream."""
        for number in SELDOM:
            self.link.send_once(mavlink.MAV_CMD_REQUEST_MESSAGE, number)

    def record(self, message: Message, now: float) -> None:
        """Record one message of the vehicle, received at `now`."""
        number = message.get_msgId()
        self.first.setdefault(number, now)
        self.count[number] = self.count.get(number, -1) + 1
        self.last[number] = now
        self.newest[number] = message
        self.telemetry.update(message, now)
        if self.parameters is not None:
            self.parameters.handle(message)

    def rate(self, message: int) -> float:
        """Return the mean rate of a message (Hz); 0 if fewer than two were received."""
        span = self.last.get(message, 0.0) - self.first.get(message, 0.0)
        return self.count[message] / span if span > 0.0 else 0.0


def listen(
    link: Link, frame: LocalFrame, wanted: Callable[[Firmware], tuple[Wanted, ...]],
    meanwhile: Callable[[list[Message], float], None],
    clock: Callable[[], float], sleep: Callable[[float], None], wall: Callable[[], float],
) -> Heard:  # fmt: skip
    """Record the autopilot's messages for at most DEADLINE + WATCHED seconds.

    The record ends sooner if no further messages are expected. `meanwhile` is called in each poll with the messages
    that were received since the previous poll, and with the time."""
    heard, streams = Heard(link, Telemetry(frame)), Streams()
    asked, known = -math.inf, math.inf
    begun = now = clock()
    while now - begun < DEADLINE + WATCHED:
        messages = link.receive(now)
        meanwhile(messages, now)
        for message in messages:
            streams.note(message.get_msgId(), now)
            heard.record(message, now)
            if message.get_msgId() == mavlink.MAVLINK_MSG_ID_SYSTEM_TIME:
                heard.wall = wall()
        link.greet(now)
        if link.vehicle is not None:
            firmware = identified(link)[1]
            if firmware is None:
                break
            heard.telemetry.firmware = firmware
            heard.parameters = heard.parameters or Parameters(wanted(firmware), firmware.bytewise)
            heard.parameters.poll(link, now)
            streams.poll(link, firmware, now)
            if now - asked >= 1.0:
                asked = now
                heard.ask()
            if not heard.examined and (math.isfinite(known) or now - begun >= DEADLINE / 2):
                heard.examined = True
                link.send_once(mavlink.MAV_CMD_RUN_PREARM_CHECKS)
        elif now - begun >= SILENCE:
            break
        known = min(known, now) if heard.telemetry.fresh(now) else known
        enough = now - known >= WATCHED or (math.isinf(known) and now - begun >= DEADLINE)
        if enough and (heard.parameters is None or heard.parameters.done(now)):
            break
        sleep(_PAUSE)
        now = clock()
    heard.began, heard.ended = begun, now
    return heard


def coordinates(p: Point) -> str:
    """Return a point as text, in metres with two decimals and without negative zeros."""
    x, y, z = (round(v, 2) + 0.0 for v in (p.x, p.y, p.z))
    return f"({x:.2f}, {y:.2f}, {z:.2f})"


def misplaced(fence: Box, height: float, p: Point) -> str:
    """Return the reason why the quad at `p` must not take off to `height` (m), or "" if it may take off.

    The quad must not take off outside the geofence, or where the ground is at the flight height or above it."""
    q = clamp(fence, p)
    if (q.x, q.y) != (p.x, p.y) or p.z > q.z or p.z < q.z - GROUND_SLACK:
        return (
            f"the autopilot puts the robot at {coordinates(p)}, outside the geofence; "
            "are the fleet's origin and its altitude (AMSL) right?"
        )
    if p.z > height - 0.2:
        return f"the ground here is at z = {p.z:.2f} m, not below flight_height {height:g}"
    return ""


def unheard(url: str, link: Link, seconds: float) -> Unready:
    """Return the error for an autopilot that has been silent for `seconds`, with a hint on the cause."""
    if link.heard is not None:
        heard = "the autopilot has fallen silent"
    else:
        heard = f"no autopilot{f' of system {link.system}' if link.system else ''} answers"
    others = ", ".join(map(str, sorted(link.others)))
    hint = "check that the autopilot is powered, and that it sends MAVLink to this address or at this baud rate"
    if others:
        hint = f"MAVLink system {others} answers: check the robot's setting `system`"
    elif link.garbled:
        hint = f"{link.garbled} bytes arrived that are no MAVLink: check the baud rate, and that the port sends MAVLink"
    return Unready(f"{heard} on {url} ({seconds:.0f} s)", hint)


RIVAL = (
    f"another ground station sends heartbeats as system {GROUND_STATION} (the number of QGroundControl), and so the "
    "autopilot does not land when this agent dies; give the ground station another number"
)


def stranger(url: str, what: str) -> Unready:
    """Return the error for a vehicle that is not an ArduPilot or PX4 copter; `what` describes it."""
    return Unready(f"{url} is {what}, not an ArduPilot or PX4 copter", "check the robot's `autopilot` setting")
