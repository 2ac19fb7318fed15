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
from targets.quad.firmware import Firmware
from targets.quad.link import Link
from targets.quad.parameters import Parameters, Wanted
from targets.quad.telemetry import Streams, Telemetry
from targets.quad.vehicles import identified

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


def unheard(url: str, link: Link, seconds: float) -> Unready:
    """What to say of a vehicle that is silent."""
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


def stranger(url: str, what: str) -> Unready:
    """What to say of a vehicle that is no copter of ours."""
    return Unready(f"{url} is {what}, not an ArduPilot or PX4 copter", "check the robot's `autopilot` setting")


def checked(
    url: str, link: Link, frame: LocalFrame, fence: Box, height: float,
    wanted: Callable[[Firmware], tuple[Wanted, ...]], clock: Callable[[], float], sleep: Callable[[float], None],
) -> list[str]:  # fmt: skip
    """A line for each thing found right, or of which to be warned, within DEADLINE. Raises Unready for the first that
    is wrong."""
    telemetry, streams, version = Telemetry(frame), Streams(), None
    parameters: Parameters | None = None
    begun = now = clock()
    while now - begun < DEADLINE:
        for message in link.receive(now):
            streams.note(message.get_msgId(), now)
            telemetry.take(message, now)
            if parameters is not None:
                parameters.take(message)
            if message.get_msgId() == mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
                version = ".".join(str(message.flight_sw_version >> shift & 0xFF) for shift in (24, 16, 8))
        link.greet(now)
        if link.vehicle is not None:
            firmware = identified(link)[1]
            if firmware is None:
                break
            telemetry.firmware = firmware
            parameters = parameters or Parameters(wanted(firmware), firmware.bytewise)
            streams.poll(link, firmware, now)
            parameters.poll(link, now)
            if telemetry.fresh(now) and version and parameters.done(now):
                break
        sleep(_PAUSE)
        now = clock()
    placed = _verdict(url, link, telemetry, version or "of unknown version", fence, height, now - begun)
    return placed + ([] if parameters is None else _compared(parameters))


def _verdict(
    url: str, link: Link, telemetry: Telemetry, version: str, fence: Box, height: float, took: float
) -> list[str]:
    what, firmware = identified(link)
    if link.vehicle is None:
        raise unheard(url, link, took)
    if firmware is None:
        raise stranger(url, what)
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


def _compared(parameters: Parameters) -> list[str]:
    differences = parameters.differences
    if differences and differences[0].wanted.vital:
        raise Unready(f"it would not take off: {differences[0]}", "set it on the autopilot, by a ground station")
    return [f"warning: {reading}" for reading in differences] or ["the parameters that matter are right"]
