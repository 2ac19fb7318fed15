"""Listens to an autopilot for some seconds without moving anything, and asks it what it does not tell by itself."""

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

SILENCE = 5.0  # seconds without a heartbeat (one per second is sent) that end the check
DEADLINE = 9.5  # seconds for a position estimate to come
WATCHED = 3.0  # seconds for which the streams are watched when it is there: rates can be told
_PAUSE = 0.05
GROUND_SLACK = 0.5  # metres by which the ground may seem to lie outside the fence, estimates being what they are

# What is asked for once a second.
SELDOM = (
    mavlink.MAVLINK_MSG_ID_SYS_STATUS,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,
)


@dataclass
class Heard:
    """What an autopilot has told: of each message the first time, the last time (seconds) and how often since the
    first, and the last of it; `wall` is our own wall clock (seconds since 1970) at the last SYSTEM_TIME;
    from `began` to `ended` it was listened to."""

    link: Link
    telemetry: Telemetry
    first: dict[int, float] = field(default_factory=dict)
    last: dict[int, float] = field(default_factory=dict)
    count: dict[int, int] = field(default_factory=dict)
    newest: dict[int, Message] = field(default_factory=dict)
    parameters: Parameters | None = None
    wall: float = 0.0
    began: float = 0.0
    ended: float = 0.0
    examined: bool = False  # whether it was asked to run its checks, the results of which it says

    def ask(self) -> None:
        """Ask for what does not come by itself."""
        for number in SELDOM:
            self.link.tell(mavlink.MAV_CMD_REQUEST_MESSAGE, number)

    def take(self, message: Message, now: float) -> None:
        """One of the vehicle's messages."""
        number = message.get_msgId()
        self.first.setdefault(number, now)
        self.count[number] = self.count.get(number, -1) + 1
        self.last[number] = now
        self.newest[number] = message
        self.telemetry.take(message, now)
        if self.parameters is not None:
            self.parameters.take(message)

    def rate(self, message: int) -> float:
        """Hz; 0 when less than two have come."""
        span = self.last.get(message, 0.0) - self.first.get(message, 0.0)
        return self.count[message] / span if span > 0.0 else 0.0


def listen(
    link: Link, frame: LocalFrame, wanted: Callable[[Firmware], tuple[Wanted, ...]],
    meanwhile: Callable[[list[Message], float], None],
    clock: Callable[[], float], sleep: Callable[[float], None], wall: Callable[[], float],
) -> Heard:  # fmt: skip
    """Within DEADLINE + WATCHED seconds; sooner when nothing more is to be expected. `meanwhile` is called with what
    came since, and the time."""
    heard, streams = Heard(link, Telemetry(frame)), Streams()
    asked, known = -math.inf, math.inf
    begun = now = clock()
    while now - begun < DEADLINE + WATCHED:
        messages = link.receive(now)
        meanwhile(messages, now)
        for message in messages:
            streams.note(message.get_msgId(), now)
            heard.take(message, now)
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
                link.tell(mavlink.MAV_CMD_RUN_PREARM_CHECKS)
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
    """Return a point in words, to the centimetre and without negative zeros."""
    x, y, z = (round(v, 2) + 0.0 for v in (p.x, p.y, p.z))
    return f"({x:.2f}, {y:.2f}, {z:.2f})"


def misplaced(fence: Box, height: float, p: Point) -> str:
    """Why a take-off from p to that height would be wrong, or nothing."""
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
    """Return what to say of a vehicle that is silent."""
    if link.heard is not None:
        heard = "the autopilot has fallen silent"
    else:
        heard = f"no autopilot{f' of system {link.system}' if link.system else ''} answers"
    others = ", ".join(map(str, sorted(link.others)))
    hint = "is it powered, and does it send MAVLink to this address or at this baud rate?"
    if others:
        hint = f"system {others} does: is the setting `system` right?"
    elif link.garbled:
        hint = f"{link.garbled} bytes came that are no MAVLink: is the baud rate right, and is it a MAVLink port?"
    return Unready(f"{heard} on {url} ({seconds:.0f} s)", hint)


RIVAL = (
    f"another ground station sends heartbeats as system {GROUND_STATION} (QGroundControl's own number): while it does, "
    "the autopilot does not land when this agent dies; give it another number"
)


def stranger(url: str, what: str) -> Unready:
    """Return what to say of a vehicle that is no copter of ours."""
    return Unready(f"{url} is {what}, not an ArduPilot or PX4 copter", "check the robot's `autopilot` setting")
