"""Settings of one car: the `body` table of its settings.json, typed and checked."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any

import msgspec

from koordgen.runtime.vehicle.platform import Unready
from targets.car.base.bicycle import turning_radius

# Share of the steering limit that planned paths use. The controller needs the remaining share to correct errors.
PLANNED_STEERING = 0.9
FROM_DRIVE = "rover"  # value of the setting `position`: the position is the estimate of the rover's own EKF


class CarSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of one car, in metres, radians and seconds.

    manifest.toml documents each setting, and has the same defaults."""

    drive: str = "vesc:/dev/ttyACM0"
    position: str = "udp:0.0.0.0:47300"
    scans: str = ""
    wheelbase: Annotated[float, msgspec.Meta(ge=0.05, le=5.0)] = 0.33
    max_steering: Annotated[float, msgspec.Meta(ge=0.05, le=1.2)] = 0.4
    max_steering_rate: Annotated[float, msgspec.Meta(ge=0.1, le=20.0)] = 3.0
    max_speed: Annotated[float, msgspec.Meta(ge=0.1, le=10.0)] = 1.0
    max_acceleration: Annotated[float, msgspec.Meta(ge=0.1, le=10.0)] = 1.5
    reached_radius: Annotated[float, msgspec.Meta(ge=0.01, le=5.0)] = 0.10
    reached_dwell: Annotated[float, msgspec.Meta(ge=0.0, le=60.0)] = 0.3
    speed_to_erpm_gain: Annotated[float, msgspec.Meta(ge=-100_000.0, le=100_000.0)] = 4614.0
    steering_to_servo_gain: Annotated[float, msgspec.Meta(ge=-10.0, le=10.0)] = -1.2135
    steering_to_servo_offset: Annotated[float, msgspec.Meta(ge=0.1, le=0.9)] = 0.5304
    length: Annotated[float, msgspec.Meta(ge=0.05, le=10.0)] = 0.5
    width: Annotated[float, msgspec.Meta(ge=0.02, le=5.0)] = 0.28
    overhang: Annotated[float, msgspec.Meta(ge=0.0, le=5.0)] = 0.085
    height: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)] = 0.25
    tracking_error: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)] = 0.08
    position_error: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)] = 0.02
    clearance: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)] = 0.1
    planner: str = "rrt-smoothed"
    reverse: bool = True
    brake_current: Annotated[float, msgspec.Meta(ge=0.5, le=60.0)] = 10.0
    braking: Annotated[float, msgspec.Meta(ge=0.2, le=20.0)] = 3.0
    full_speed: Annotated[float, msgspec.Meta(ge=0.2, le=20.0)] = 3.0

    @property
    def is_rover(self) -> bool:
        """Return whether an ArduPilot rover drives the car."""
        return self.drive.startswith("rover:")

    @property
    def steering_limit(self) -> float:
        """Largest steering angle (rad) that is possible to both sides.

        It is less than `max_steering` if the servo of a VESC reaches the end of its range (0 to 1) first."""
        if self.is_rover:
            return self.max_steering
        room = min(self.steering_to_servo_offset, 1.0 - self.steering_to_servo_offset)
        return min(self.max_steering, room / abs(self.steering_to_servo_gain))

    @property
    def planned_radius(self) -> float:
        """Smallest turning radius (m) of planned paths."""
        return turning_radius(PLANNED_STEERING * self.steering_limit, self.wheelbase)


def decode(body: Mapping[str, Any]) -> CarSettings:
    """Return the settings of one car, checked. Raises Unready that names the wrong setting."""
    try:
        settings = msgspec.convert(dict(body), CarSettings)
    except msgspec.ValidationError as error:
        raise Unready(f"the car's settings: {error}", "correct the robot's `settings` in the fleet file") from None
    for key in ("speed_to_erpm_gain", "steering_to_servo_gain"):
        if abs(getattr(settings, key)) < 1e-3:
            raise Unready(f"the car's settings: {key} is 0", "measure it on the car; 0 cannot drive or steer")
    numbers = (value for value in msgspec.structs.asdict(settings).values() if isinstance(value, float))
    if not all(map(math.isfinite, numbers)) or settings.steering_limit < 0.02:
        raise Unready(
            f"the car's settings: the servo allows only {settings.steering_limit:.3f} rad of steering on one side",
            "correct steering_to_servo_gain and steering_to_servo_offset",
        )
    if settings.position == FROM_DRIVE and not settings.is_rover:
        hint = "write `drive: rover:URL`, or `position: udp:HOST:PORT` for the feed of a base station"
        raise Unready("the car's settings: position is rover, but the drive is not a rover", hint)
    if settings.is_rover and settings.max_speed > settings.full_speed:
        raise Unready(
            f"the car's settings: max_speed {settings.max_speed:g} is more than full_speed {settings.full_speed:g}",
            "measure full_speed, the rover's speed at full throttle, or lower max_speed",
        )
    return settings
