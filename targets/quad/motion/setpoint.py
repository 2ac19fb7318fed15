"""Setpoints: what is sent to the autopilot so that the vehicle has the reference's state when the reference has it.

An autopilot does not take a setpoint as it comes: ArduPilot shapes it (AC_PosControl, AP_Math's shape_pos_vel_accel)
with the gains KPv = PSC_JERK_NE / 2 WP_ACC = 1/s and KPa = PSC_JERK_NE / WP_ACC = 2/s, vertically 2.5/s and 5/s:

    x'' = KPa (KPv (p - x) + v - x')      p, v: the setpoint's position and velocity; x: what the vehicle is steered to

A position alone is so followed 1/KPv = 1 s late. With the velocity, x misses what x'' takes: p'' / KPa KPv, 0.16 m on a
circle of 2 m at 0.8 m/s. The velocity v + p''/KPa gives it back: x = p. What is steered to is reached a lean later (0.1
s), and a setpoint takes the link's time. So velocity is sent for 1/KPa and the lean ahead, by the mean of p'' over the
next third of a second, because p'' jumps; and position and velocity both for the link ahead.

KPv p + v is all that counts. So near the fence, velocity is exchanged for position: 1/KPv metres for each m/s. When
setpoints cease, the vehicle runs on to p + RUN_ON v at v, and then needs room to stop. PX4's
gains come to much the same (MPC_XY_P 0.95/s, MPC_XY_VEL_P_ACC 1.8/s).

The demand KPv (p - x) + v is what the vehicle's velocity goes to. Nothing else limits it, neither for a position alone
nor with a velocity (WP_SPD is 5 m/s or more). So p is brought so near to the vehicle that the demand keeps the speed
within the limits (`bounded`).
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
from targets.quad.motion.trajectory import ZERO, Limits, State, norm

# Bits of the type mask say what to ignore; position, velocity and acceleration are each used whole or not at all.
POSITION = 0xDF8
POSITION_VELOCITY = 0xDC0
YAW = 0x400  # taken away when a yaw is given

OBEYED = 0.5  # the part of a demanded change of velocity that is there a third of a second later: 1 - exp(-KPa t)
RUN_ON = 3.0  # s for which an autopilot keeps the last velocity (GUID_TIMEOUT)
# How it stops then: after so many seconds of going on, by so many m/s^2, horizontally (WP_ACC) and up (WP_ACC_Z).
LEANING = 0.3
BRAKING = (2.5, 1.0)


class NotSendable(ValueError):
    """A setpoint that is not finite: it would abort the autopilot's process, so it is never sent."""


@dataclass(frozen=True, slots=True)
class Shaping:
    """What an autopilot makes of setpoints, in seconds, horizontally and vertically: `late` is 1/KPv, `lead` 1/KPa and
    the time to lean or to change thrust; `delay` is the link's and half of the setpoints' spacing; `ahead` is over how
    long the reference's acceleration is averaged."""

    late: tuple[float, float] = (1.0, 0.4)
    lead: tuple[float, float] = (0.6, 0.25)
    delay: float = 0.05
    ahead: float = 0.35


ARDUPILOT = Shaping()


@dataclass(frozen=True, slots=True)
class Aim:
    """A setpoint in the fleet's ENU: position (m), velocity (m/s) or None, yaw (rad from east) or None."""

    position: Point
    velocity: Point | None = None
    yaw: float | None = None


def aimed(reference: Reference, here: State, shaping: Shaping, limits: Limits) -> Aim:
    """Return the aim to send now, within the limits and in their box for as long as it may be obeyed; where the vehicle
    is outside the box, between both. `here` is the vehicle's state when the aim arrives.

    The aim is a position alone on hold, at rest and for ways so short that they are none: ArduPilot's controller starts
    anew when the kind of setpoint changes, so that is done while the vehicle stands."""
    state = reference.at(shaping.delay)
    if reference.alone:
        return bounded(Aim(clamp(limits.box, state.position)), here, shaping, limits)
    push = (reference.at(shaping.delay + shaping.ahead).velocity - state.velocity) / shaping.ahead
    wanted = state.velocity + _scaled(push, shaping.lead)
    velocity = limits.limited(wanted)
    # The position makes up for what the limit takes from the velocity.
    position = state.position + _scaled(wanted - velocity, shaping.late)
    return bounded(_exchanged(position, velocity, shaping, limits.box), here, shaping, limits)


def bounded(aim: Aim, here: State, shaping: Shaping, limits: Limits) -> Aim:
    """Return the aim, brought so near to the vehicle that the velocity that it leads to is within the limits. It leaves
    the box no farther than the vehicle has."""
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
    """Return the seconds of a speed (m/s) in which a vehicle would go as far as it does after the last setpoint."""
    return RUN_ON + LEANING + speed / (2 * braking)


def _scaled(p: Point, by: tuple[float, float]) -> Point:
    """Return the vector times a factor for its horizontal and one for its vertical part."""
    return Point(p.x * by[0], p.y * by[0], p.z * by[1])


def _exchanged(position: Point, velocity: Point, shaping: Shaping, box: Box) -> Aim:
    """Return the same demand, with as much velocity as leads to no face of the box when the vehicle runs on."""
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
    """One axis: position and velocity with p' + seconds v' within lo to hi, and p' + late v' as it was if that is
    there."""
    p = max(lo, min(p, hi))
    face = hi if v > 0 else lo
    if (face - p - seconds * v) * (1 if v > 0 else -1) >= 0:
        return p, v
    kept = (face - p - late * v) / (seconds - late)
    if kept * v <= 0:
        return max(lo, min(p + late * v, hi)), 0.0
    return p + late * (v - kept), kept


def setpoint(vehicle: Vehicle, frame: LocalFrame, fence: Box, aim: Aim) -> Message:
    """The message for an aim: the position clamped to the fence, the velocity shortened until it leads to no face of it
    when the vehicle runs on. Raises NotSendable unless all is finite.

    GLOBAL_INT, because robots share no local frame; AMSL (frame 5), because a height above home would be a height
    above where this vehicle happened to arm. Unused fields are zero, never NaN.
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
