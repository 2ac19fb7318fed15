"""ArduPilot's JSON interface between its SITL build and a simulation of the vehicle.

Sources: libraries/SITL/examples/JSON/readme.md and SIM_JSON.cpp of ArduPilot. Servo outputs arrive as binary frames.
The vehicle's state is sent back as one line of JSON between two line ends. Frames here: world is NED about the fleet's
origin; body is FRD (forward, right, down)."""

from __future__ import annotations

import json
import math
import struct
from dataclasses import dataclass

from targets.sim.base.bodies import Vector
from targets.sim.physics.world import BodyMotion

PORT, PORT_STEP = 9002, 10  # of the first instance, and the distance from one instance to the next
MAGIC_16, MAGIC_32 = 18458, 29569
_HEAD = struct.Struct("<HHI")
_CHANNELS = {MAGIC_16: struct.Struct("<HHI16H"), MAGIC_32: struct.Struct("<HHI32H")}
_HALF = math.sqrt(0.5)
Quaternion = tuple[float, float, float, float]  # w, x, y, z


@dataclass(frozen=True, slots=True)
class Servos:
    """One frame of servo outputs.

    `rate`: states a second that the autopilot wants. `count`: goes up with each state that the autopilot received, and
    restarts with the autopilot. `pwm`: microseconds, 16 or 32 channels."""

    rate: int
    count: int
    pwm: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class VehicleState:
    """True state of a vehicle at `time` (s).

    Angular rate `gyro` (rad/s) and specific force `force` (m/s^2) are in the body frame; position (m), velocity (m/s)
    and attitude in the world frame."""

    time: float
    gyro: Vector
    force: Vector
    position: Vector
    velocity: Vector
    attitude: Quaternion


def servos(datagram: bytes) -> Servos | None:
    """Decode a frame. Return None for an unknown magic or a length that does not fit the magic."""
    if len(datagram) < _HEAD.size:
        return None
    form = _CHANNELS.get(_HEAD.unpack_from(datagram)[0])
    if form is None or len(datagram) != form.size:
        return None
    _, rate, count, *pwm = form.unpack(datagram)
    return Servos(rate, count, tuple(pwm))


def line(vehicle: VehicleState, volts: float, amperes: float) -> bytes:
    """Encode a state as a line of JSON.

    It has angles besides the quaternion: older versions read only angles."""
    fields = {
        "timestamp": round(vehicle.time, 12),  # ArduPilot computes a rate from differences, in single precision
        "imu": {"gyro": _rounded(vehicle.gyro), "accel_body": _rounded(vehicle.force)},
        "position": _rounded(vehicle.position),
        "attitude": _rounded(angles(vehicle.attitude)),
        "quaternion": _rounded(vehicle.attitude),
        "velocity": _rounded(vehicle.velocity),
        "battery": {"voltage": round(volts, 3), "current": round(amperes, 3)},
    }
    return b"\n" + json.dumps(fields, separators=(",", ":")).encode("ascii") + b"\n"


def _rounded(values: tuple[float, ...]) -> list[float]:
    return [round(v, 7) + 0.0 for v in values]  # + 0.0: no -0.0


def vehicle(
    motion: BodyMotion, reference: Vector, before: Vector, gravity: float, step: float, time: float
) -> VehicleState:
    """Convert a body's motion from ENU.

    `reference` is the body's reference point, `before` its velocity `step` seconds ago. The specific force is the
    measured acceleration less gravity."""
    x, y, z, w = motion.orientation
    attitude = _to_ned((w, x, y, z))
    east, north, up = motion.velocity
    pulled = [(now - then) / step for now, then in zip(motion.velocity, before, strict=True)]
    force = to_body_frame((pulled[1], pulled[0], -(pulled[2] + gravity)), attitude)
    gyro = to_body_frame((motion.spin[1], motion.spin[0], -motion.spin[2]), attitude)
    position = (reference[1], reference[0], -reference[2])
    return VehicleState(time, gyro, force, position, (north, east, -up), attitude)


def interpolate(a: VehicleState, b: VehicleState, share: float) -> VehicleState:
    """Interpolate between two states. The specific force is that of `b`: it is the one that leads there."""
    attitude = _mixed(a.attitude, b.attitude, share)
    size = math.sqrt(sum(v * v for v in attitude))
    w, x, y, z = (v / size for v in attitude)
    return VehicleState(
        a.time + share * (b.time - a.time), _blend(a.gyro, b.gyro, share), b.force,
        _blend(a.position, b.position, share), _blend(a.velocity, b.velocity, share), (w, x, y, z),
    )  # fmt: skip


def angles(q: Quaternion) -> Vector:
    """Return roll, pitch and yaw (rad) of an attitude."""
    w, x, y, z = q
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
    return roll, pitch, math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def to_body_frame(v: Vector, q: Quaternion) -> Vector:
    """Rotate a vector from the world frame into the body frame."""
    w, x, y, z = q
    tx, ty, tz = 2 * (v[1] * z - v[2] * y), 2 * (v[2] * x - v[0] * z), 2 * (v[0] * y - v[1] * x)
    return (
        v[0] + w * tx + (ty * z - tz * y),
        v[1] + w * ty + (tz * x - tx * z),
        v[2] + w * tz + (tx * y - ty * x),
    )


def _to_ned(q: Quaternion) -> Quaternion:
    """Convert an attitude from FLU in ENU to FRD in NED.

    Half a turn about the line between north and east first, then half a turn about the body's own forward axis."""
    w, x, y, z = _product(_product((0.0, _HALF, _HALF, 0.0), q), (0.0, 1.0, 0.0, 0.0))
    return (w, x, y, z) if w >= 0 else (-w, -x, -y, -z)


def _product(a: Quaternion, b: Quaternion) -> Quaternion:
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


def _mixed(a: Quaternion, b: Quaternion, share: float) -> list[float]:
    same = 1.0 if sum(p * q for p, q in zip(a, b, strict=True)) >= 0 else -1.0
    return [p * same * (1 - share) + q * share for p, q in zip(a, b, strict=True)]


def _blend(a: Vector, b: Vector, share: float) -> Vector:
    x, y, z = (p + share * (q - p) for p, q in zip(a, b, strict=True))
    return x, y, z
