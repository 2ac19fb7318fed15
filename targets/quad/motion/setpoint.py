"""Setpoints that make the vehicle follow the reference without lag.

The autopilot shapes each setpoint before it follows it, and this module compensates the shaping.

Model. ArduPilot shapes each setpoint (AC_PosControl, shape_pos_vel_accel in AP_Math). The horizontal gains are
KPv = PSC_JERK_NE / 2 WP_ACC = 1/s and KPa = PSC_JERK_NE / WP_ACC = 2/s; the vertical ones are 2.5/s and 5/s. PX4 has
much the same gains (MPC_XY_P 0.95/s, MPC_XY_VEL_P_ACC 1.8/s).

    x'' = KPa (KPv (p - x) + v - x')      p, v: the setpoint's position and velocity; x: the shaped position target

Lag. With setpoints of a position only, x follows 1/KPv = 1 s late. With p and v, x has an error of p'' / (KPa KPv),
which is 0.16 m on a circle of 2 m at 0.8 m/s. Sending the velocity v + p''/KPa instead removes that error: x = p.

Delays. The vehicle reaches x after the time to lean (0.1 s), and a setpoint reaches the autopilot after the link's
delay. So the setpoint has the position and the velocity of the reference after the link's delay. The velocity is also
extrapolated by 1/KPa and the time to lean, with the mean of p'' over the next third of a second, because p'' jumps.

Geofence. When setpoints cease, the vehicle goes on at v to p + RUN_ON v, and then needs room to stop. The shaping
depends on KPv p + v only. So near the fence, velocity is exchanged for position: 1/KPv metres for each m/s.

Speed limit. The vehicle's velocity converges to the demand KPv (p - x) + v. The autopilot does not limit it to the
robot's limits, neither for a position only nor with a velocity (WP_SPD is 5 m/s or more). So `bounded` moves p so near
to the vehicle that the demand keeps the speed within the limits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from koordgen.runtime.config.settings import Box
from koordgen.runtime.values.geodesy import LocalFrame
from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.safety import clamp
from targets.mavlink.framing import Message
from targets.mavlink.link import Vehicle
from targets.quad.motion.reference import Reference
from targets.quad.motion.trajectory import ZERO, MotionLimits, MotionState, norm

# Type masks of SET_POSITION_TARGET: each bit marks a field to ignore. Autopilots use all three components of position,
# velocity or acceleration, or none.
POSITION = 0xDF8  # ignore all but the position
POSITION_VELOCITY = 0xDC0  # ignore all but position and velocity
YAW = 0x400  # bit to ignore the yaw; it is cleared if the setpoint has a yaw

OBEYED = 0.5  # share of a demanded change of velocity that is achieved after a third of a second: 1 - exp(-KPa t)
RUN_ON = 3.0  # s for which an autopilot keeps the last setpoint's velocity (GUID_TIMEOUT)

# If no setpoint arrives, the vehicle flies on for RUN_ON and LEANING (s), and then brakes at BRAKING (m/s^2). The first
# value of BRAKING is horizontal (WP_ACC), the second vertical (WP_ACC_Z).
LEANING = 0.3
BRAKING = (2.5, 1.0)


class NotSendable(ValueError):
    """Raised for a setpoint that is not finite.

    Such a setpoint is never sent, because it would abort the autopilot's process."""


@dataclass(frozen=True, slots=True)
class Shaping:
    """Response of an autopilot to setpoints, in the model that the module's docstring describes.

    All values are in seconds. Pairs are (horizontal, vertical).

    `late`: 1/KPv.
    `lead`: 1/KPa plus the time to lean, or to change thrust.
    `delay`: delay of the link plus half of the time between setpoints.
    `ahead`: time over which the reference's acceleration is averaged.
    """

    late: tuple[float, float] = (1.0, 0.4)
    lead: tuple[float, float] = (0.6, 0.25)
    delay: float = 0.05
    ahead: float = 0.35


ARDUPILOT = Shaping()


@dataclass(frozen=True, slots=True)
class Aim:
    """Setpoint in the fleet's ENU frame: position (m), velocity (m/s), yaw (rad from east).

    A setpoint without a velocity or without a yaw has None there."""

    position: Point
    velocity: Point | None = None
    yaw: float | None = None


def aimed(reference: Reference, here: MotionState, shaping: Shaping, limits: MotionLimits) -> Aim:
    """Return the setpoint to send now. `here`: predicted state of the vehicle when the setpoint arrives.

    The setpoint is within the limits, and keeps the vehicle inside the box of the limits for as long as the autopilot
    may follow it. If the vehicle is outside the box, the setpoint is between the vehicle and the box.

    While the reference is paused, stands, or moves by a negligible distance, the setpoint has a position but no
    velocity. ArduPilot's controller restarts when the kind of setpoint changes, so the kind changes only while the
    vehicle stands."""
    state = reference.at(shaping.delay)
    if reference.alone:
        return bounded(Aim(clamp(limits.box, state.position)), here, shaping, limits)
    push = (reference.at(shaping.delay + shaping.ahead).velocity - state.velocity) / shaping.ahead
    wanted = state.velocity + _scaled(push, shaping.lead)
    velocity = limits.limited(wanted)
    # If the limit reduces the velocity, the position is moved forward, so that the demand stays the same.
    position = state.position + _scaled(wanted - velocity, shaping.late)
    return bounded(_exchanged(position, velocity, shaping, limits.box), here, shaping, limits)


def bounded(aim: Aim, here: MotionState, shaping: Shaping, limits: MotionLimits) -> Aim:
    """Return the setpoint, moved so near to the vehicle that the resulting velocity is within the limits.

    The moved setpoint is inside the box, or no farther outside the box than the vehicle."""
    velocity, (level, up) = aim.velocity or ZERO, shaping.late
    demand = velocity + _scaled(aim.position - here.position, (1 / level, 1 / up))
    soon = here.velocity + (demand - here.velocity) * OBEYED
    allowed = limits.limited(soon)
    if allowed == soon:
        return aim
    demand = here.velocity + (allowed - here.velocity) / OBEYED
    at, lo, hi = here.position, limits.box.lo, limits.box.hi
    reach = Box(
        Point(min(lo.x, at.x), min(lo.y, at.y), min(lo.z, at.z)),
        Point(max(hi.x, at.x), max(hi.y, at.y), max(hi.z, at.z)),
    )
    return replace(aim, position=clamp(reach, at + _scaled(demand - velocity, shaping.late)))


def runs_on(speed: float, braking: float = BRAKING[0]) -> float:
    """Return the distance that a vehicle flies after its last setpoint, as a time (s) at its present speed.

    `speed`: present speed, m/s. `braking`: deceleration, m/s^2."""
    return RUN_ON + LEANING + speed / (2 * braking)


def _scaled(p: Point, by: tuple[float, float]) -> Point:
    """Return the vector `p`, with its horizontal part multiplied by by[0] and its vertical part by by[1]."""
    return Point(p.x * by[0], p.y * by[0], p.z * by[1])


def _exchanged(position: Point, velocity: Point, shaping: Shaping, box: Box) -> Aim:
    """Return a setpoint with the same demand whose velocity does not lead the vehicle out of the box.

    The vehicle stays inside even if no further setpoint arrives, and the vehicle flies on (`runs_on`)."""
    axes = [
        _axis(p, v, lo, hi, late, runs_on(abs(v), braking))
        for p, v, lo, hi, late, braking in zip(
            (position.x, position.y, position.z),
            (velocity.x, velocity.y, velocity.z),
            (box.lo.x, box.lo.y, box.lo.z),
            (box.hi.x, box.hi.y, box.hi.z),
            (shaping.late[0], *shaping.late),
            (BRAKING[0], *BRAKING),
            strict=True,
        )
    ]
    return Aim(Point(*(p for p, _ in axes)), Point(*(v for _, v in axes)))


def _axis(p: float, v: float, lo: float, hi: float, late: float, seconds: float) -> tuple[float, float]:
    """Return a position p' and a velocity v' on one axis, so that p' + seconds v' is between lo and hi.

    If the demand p + late v is between lo and hi, p' + late v' equals this demand."""
    p = max(lo, min(p, hi))
    face = hi if v > 0 else lo
    if (face - p - seconds * v) * (1 if v > 0 else -1) >= 0:
        return p, v
    kept = (face - p - late * v) / (seconds - late)
    if kept * v <= 0:
        return max(lo, min(p + late * v, hi)), 0.0
    return p + late * (v - kept), kept


def setpoint(vehicle: Vehicle, frame: LocalFrame, fence: Box, aim: Aim) -> Message:
    """Return the MAVLink message for an aim. Raises NotSendable unless all values are finite.

    The position is clamped to the geofence. The velocity is reduced until the vehicle stays inside the fence even if it
    flies on after this setpoint (`runs_on`).

    The message is SET_POSITION_TARGET_GLOBAL_INT, because robots share no local frame. Its altitude is AMSL (frame 5)
    and not relative to home, because each vehicle's home is the place where it armed. Unused fields are zero, never
    NaN.
    """
    p, v, yaw = aim.position, aim.velocity, aim.yaw
    if not all(map(math.isfinite, (p.x, p.y, p.z, *((v.x, v.y, v.z) if v else ()), yaw or 0.0))):
        raise NotSendable(f"{aim}")
    q = clamp(fence, p)
    latitude, longitude, altitude = frame.geodetic(q.x, q.y, q.z)
    mask, north, east, down = POSITION, 0.0, 0.0, 0.0
    if v is not None:
        mask = POSITION_VELOCITY
        seconds = runs_on(norm(v))
        end = clamp(fence, q + v * seconds)
        north, east, down = frame.ned(latitude, longitude, *_vector((end - q) / seconds))
    heading = 0.0
    if yaw is not None:
        mask, heading = mask & ~YAW, math.remainder(math.pi / 2 - yaw, math.tau)
    return mavlink.MAVLink_set_position_target_global_int_message(
        0, vehicle.system, vehicle.component, mavlink.MAV_FRAME_GLOBAL_INT, mask,
        round(latitude * 1e7), round(longitude * 1e7), altitude, north, east, down, 0, 0, 0, heading, 0,
    )  # fmt: skip


def _vector(p: Point) -> tuple[float, float, float]:
    return p.x, p.y, p.z
