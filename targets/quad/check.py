"""Looks at an autopilot without moving anything: who answers, what it is, and whether it knows where it is."""

from __future__ import annotations

from collections.abc import Callable

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from koordgen.runtime.geodesy import LocalFrame
from koordgen.runtime.platform import Unready
from koordgen.runtime.settings import Box
from targets.quad.flight import coordinates, misplaced
from targets.quad.link import Link
from targets.quad.telemetry import Streams, Telemetry, firmware

DEADLINE = 9.5  # seconds
_PAUSE = 0.05


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
