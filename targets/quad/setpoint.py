"""Position setpoints: what is sent to the autopilot, and how it moves towards the target.

Why a carrot. The speed limit is kept by moving the point that is sent, at `max_speed`, and by never letting it get
farther from the vehicle than a leash. The alternatives: DO_CHANGE_SPEED is forgotten by ArduPilot whenever its guided
mode starts anew, so a lost message means WPNAV_SPEED, 5 to 10 m/s among people; position and velocity together follow
more closely but run on for 3 s when the link breaks. A position alone is held for ever: a broken link leaves the
vehicle at most a leash from where it was, and every motion ends with a position-only setpoint of itself.
"""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from koordgen.runtime.geodesy import LocalFrame
from koordgen.runtime.safety import clamp
from koordgen.runtime.settings import Box
from koordgen.runtime.values import Point, distance
from targets.quad.framing import Message
from targets.quad.link import Vehicle

# Bits of the type mask say what to ignore; position, velocity and acceleration are each used whole or not at all.
POSITION = 0xDF8
POSITION_YAW = 0x9F8
VELOCITY = 0xDC7
POSITION_VELOCITY = 0xDC0

LEASH_TIME = 1.5  # seconds; ArduPilot follows a moving position about 1.1 s behind
LEASH_LENGTH = 0.5  # metres, added to it


class NotSendable(ValueError):
    """A setpoint that is not finite: it would abort the autopilot's process, so it is never sent."""


def setpoint(vehicle: Vehicle, frame: LocalFrame, fence: Box, p: Point) -> Message:
    """A position-only setpoint at p (fleet's ENU), clamped to the fence. Raises NotSendable unless p is finite.

    GLOBAL_INT, because robots share no local frame; AMSL (frame 5), because a height above home would be a height
    above where this vehicle happened to arm. Unused fields are zero, never NaN.
    """
    if not (math.isfinite(p.x) and math.isfinite(p.y) and math.isfinite(p.z)):
        raise NotSendable(f"({p.x}, {p.y}, {p.z})")
    q = clamp(fence, p)
    latitude, longitude, altitude = frame.geodetic(q.x, q.y, q.z)
    return mavlink.MAVLink_set_position_target_global_int_message(
        0, vehicle.system, vehicle.component, mavlink.MAV_FRAME_GLOBAL_INT, POSITION,
        round(latitude * 1e7), round(longitude * 1e7), altitude, 0, 0, 0, 0, 0, 0, 0, 0,
    )  # fmt: skip


class Carrot:
    """The moving point between the vehicle and its goal. Speeds in m/s, lengths in m."""

    def __init__(self, max_speed: float) -> None:
        self._speed = max_speed
        self._leash = LEASH_LENGTH + LEASH_TIME * max_speed
        self.at: Point | None = None

    def step(self, goal: Point, position: Point, seconds: float) -> Point:
        """Move for so many seconds towards the goal, and towards the vehicle where that has fallen behind."""
        at = position if self.at is None else self.at
        behind = distance(at, position)
        if behind > self._leash:
            at = position + (at - position) * (self._leash / behind)
        self.at = _towards(at, goal, self._speed * min(max(seconds, 0.0), 0.2))
        return self.at

    def drop(self) -> None:
        """Begin again at the vehicle's position."""
        self.at = None


def _towards(at: Point, goal: Point, step: float) -> Point:
    far = distance(at, goal)
    return goal if far <= step else at + (goal - at) * (step / far)
