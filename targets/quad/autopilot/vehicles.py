"""Vehicles that this target can fly, identified by the type and autopilot fields of HEARTBEAT."""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from targets.mavlink.link import Link
from targets.quad.autopilot.ardupilot import ARDUPILOT
from targets.quad.autopilot.firmware import Firmware
from targets.quad.autopilot.px4 import PX4

COPTERS = {
    mavlink.MAV_TYPE_QUADROTOR: "quadrotor",
    mavlink.MAV_TYPE_COAXIAL: "coaxial copter",
    mavlink.MAV_TYPE_HELICOPTER: "helicopter",
    mavlink.MAV_TYPE_HEXAROTOR: "hexarotor",
    mavlink.MAV_TYPE_OCTOROTOR: "octorotor",
    mavlink.MAV_TYPE_TRICOPTER: "tricopter",
    mavlink.MAV_TYPE_DODECAROTOR: "dodecarotor",
    mavlink.MAV_TYPE_DECAROTOR: "decarotor",
}
FIRMWARES = {mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: ARDUPILOT, mavlink.MAV_AUTOPILOT_PX4: PX4}


def identified(link: Link) -> tuple[str, Firmware | None]:
    """Return a description of the vehicle, and its firmware.

    The firmware is None if there is no vehicle, or this target cannot fly it."""
    vehicle = link.vehicle
    if vehicle is None:
        return "nothing", None
    kind, firmware = COPTERS.get(vehicle.type), FIRMWARES.get(vehicle.autopilot)
    maker = f"autopilot {vehicle.autopilot}" if firmware is None else firmware.name
    what = f"{maker} {kind or f'vehicle of MAV_TYPE {vehicle.type}'}"
    return what, firmware if kind is not None else None
