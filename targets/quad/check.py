"""Looks at an autopilot without moving anything: who answers, what it is, whether it knows where it is, and whether a
take-off from there would be right."""

from __future__ import annotations

from collections.abc import Callable

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from koordgen.runtime.geodesy import LocalFrame
from koordgen.runtime.platform import Unready
from koordgen.runtime.safety import clamp
from koordgen.runtime.settings import Box
from koordgen.runtime.values import Point
from targets.quad.link import Link
from targets.quad.telemetry import Streams, Telemetry, firmware

DEADLINE = 9.5  # seconds
_PAUSE = 0.05
GROUND_SLACK = 0.5  # metres by which the ground may seem to lie outside the fence, estimates being what they are


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


def checked(
    url: str, link: Link, frame: LocalFrame, fence: Box, height: float,
    clock: Callable[[], float], sleep: Callable[[float], None],
) -> list[str]:  # fmt: skip
    """A line for each thing found right, within DEADLINE. Raises Unready for the first that is wrong."""
    telemetry, streams, version = Telemetry(frame), Streams(), None
    begun = now = clock()
    while now - begun < DEADLINE and not (telemetry.fresh(now) and version):
        for message in link.receive(now):
            streams.note(message.get_msgId(), now)
            telemetry.take(message, now)
            if message.get_msgId() == mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
                version = ".".join(str(message.flight_sw_version >> shift & 0xFF) for shift in (24, 16, 8))
        link.greet(now)
        if link.vehicle is not None:
            if not firmware(link)[1]:
                break
            streams.poll(link, now)
            if version is None:
                link.ask(now, mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
        sleep(_PAUSE)
        now = clock()
    return _verdict(url, link, telemetry, version or "of unknown version", fence, height)


def _verdict(url: str, link: Link, telemetry: Telemetry, version: str, fence: Box, height: float) -> list[str]:
    what, flyable = firmware(link)
    if link.vehicle is None:
        raise Unready(
            f"no autopilot answers on {url}",
            "is it powered, and does it send MAVLink to this address or at this baud rate?",
        )
    if not flyable:
        raise Unready(f"{url} is {what}, not an ArduPilot copter", "check the robot's `autopilot` setting")
    p = telemetry.position
    if p is None:
        raise Unready(
            f"{what} on {url} has no position estimate yet",
            "it takes about 45 s from power-up, and a positioning source that works",
        )
    fault = "" if telemetry.flying else misplaced(fence, height, p)
    if fault:
        raise Unready(fault)
    return [
        f"autopilot on {url}: {what} {version}, system {link.vehicle.system}",
        f"position estimate: {coordinates(p)} m; in {telemetry.mode_name}",
    ]
