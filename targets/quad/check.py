"""Listens to an autopilot for some seconds without moving anything, and asks it what it does not tell by itself."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from koordgen.runtime.geodesy import LocalFrame
from koordgen.runtime.safety import clamp
from koordgen.runtime.settings import Box
from koordgen.runtime.values import Point
from targets.quad.framing import Message
from targets.quad.link import Link
from targets.quad.telemetry import Streams, Telemetry, firmware

DEADLINE = 9.5  # seconds for a position estimate to come
WATCHED = 3.0  # seconds for which the streams are watched when it is there: rates can be told
_PAUSE = 0.05
GROUND_SLACK = 0.5  # metres by which the ground may seem to lie outside the fence, estimates being what they are

# What is asked for once a second until it has come.
ONCE = (
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,
)


@dataclass
class Heard:
    """What an autopilot has told: of each message the first time, the last time (seconds) and how often since the
    first, and the last of it; `wall` is our own wall clock (seconds since 1970) at the last SYSTEM_TIME."""

    link: Link
    telemetry: Telemetry
    first: dict[int, float] = field(default_factory=dict)
    last: dict[int, float] = field(default_factory=dict)
    count: dict[int, int] = field(default_factory=dict)
    newest: dict[int, Message] = field(default_factory=dict)
    wall: float = 0.0

    def take(self, message: Message, now: float) -> None:
        number = message.get_msgId()
        self.first.setdefault(number, now)
        self.count[number] = self.count.get(number, -1) + 1
        self.last[number] = now
        self.newest[number] = message
        self.telemetry.take(message, now)

    def rate(self, message: int) -> float:
        """Hz; 0 when less than two have come."""
        span = self.last.get(message, 0.0) - self.first.get(message, 0.0)
        return self.count[message] / span if span > 0.0 else 0.0


def listen(
    link: Link, frame: LocalFrame,
    clock: Callable[[], float], sleep: Callable[[float], None], wall: Callable[[], float],
) -> Heard:  # fmt: skip
    """Within DEADLINE + WATCHED seconds; sooner when nothing more is to be expected."""
    heard, streams = Heard(link, Telemetry(frame)), Streams()
    asked, watching = -math.inf, False
    now = clock()
    end = now + DEADLINE
    while now < end:
        for message in link.receive(now):
            streams.note(message.get_msgId(), now)
            heard.take(message, now)
            if message.get_msgId() == mavlink.MAVLINK_MSG_ID_SYSTEM_TIME:
                heard.wall = wall()
        link.greet(now)
        if link.vehicle is not None:
            if not firmware(link)[1]:
                break
            streams.poll(link, now)
            if now - asked >= 1.0:
                asked = now
                for number in ONCE:
                    if number not in heard.newest:
                        link.tell(mavlink.MAV_CMD_REQUEST_MESSAGE, number)
        if not watching and heard.telemetry.fresh(now):
            watching, end = True, now + WATCHED
        sleep(_PAUSE)
        now = clock()
    return heard


def coordinates(p: Point) -> str:
    """A point in words, to the centimetre and without negative zeros."""
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
