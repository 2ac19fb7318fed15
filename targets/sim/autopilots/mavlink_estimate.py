"""Estimator of a simulated copter: an EKF fed by its own GPS or by positions from outside.

Models the visible behaviour of ArduPilot's EKF3: when it is ready, the texts that it sends, how noise and delay of its
input change its error, and what happens when the input ends. Observed on 4.7:

- With GPS_INPUT slower than 4 Hz, the GPS counts as not healthy. A time that does not increase is no new fix.
- Vision needs an origin from outside, after "EKF3 IMU0 initialised".
- The end of an input is noticed only after 7 to 8 s. Meanwhile the estimate drifts off.
- After the origin from outside, ArduPilot resets its height datum: the EKF's own origin rises to the vehicle, but the
origin that it reports, about which poses are sent, does not. From then on the vehicle's height at the reset counts
twice (NavEKF3_core::resetHeightDatum, and common_EKF_origin in getPosD)."""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from koordgen.runtime.values.geodesy import LocalFrame
from targets.sim.autopilots.mavlink_params import SimulatedParameters
from targets.sim.base.bodies import BodyState, Vector
from targets.sim.base.fault_state import FaultState
from targets.sim.sensing.own_gps import OwnGps

LOST = 7.5  # seconds without a fix of its own GPS after which the EKF gives up its position
OWN_LOST = 7.9  # ... without a fix of its own GPS
HEALTHY_PERIOD = 0.245  # seconds: GPS_MAX_DELTA_MS
DEFAULT_GPS_DELAY = 0.22  # seconds, for GPS1_DELAY_MS = 0
VISION_PERIOD = 0.3  # seconds without a message after which visual odometry is not healthy
# m/s^2, bias of the accelerometers: without corrections the estimate drifts with it. So a vehicle that has lost its
# position input lands 2.9 m off, as observed.
BIAS = 0.021
POSITION_SHARE, VELOCITY_SHARE = 0.3, 0.05  # shares of an innovation that correct the estimate
# Shares of the boot time, as observed in 42 s.
INITIALISED, VISION_READY, CHECKS = 0.2, 0.55, 0.24
# share of the boot time; for at most this long after the first position, IMUs disagree and prevent arming
IMUS_SETTLE = 25 / 42
GPS, VISION = 3, 6  # values of EK3_SRC1_POSXY
GPS_YAW, GPS_OR_COMPASS_YAW = 2, 3  # values of EK3_SRC1_YAW
_READY = (
    mavlink.EKF_ATTITUDE | mavlink.EKF_VELOCITY_HORIZ | mavlink.EKF_VELOCITY_VERT | mavlink.EKF_POS_HORIZ_REL
    | mavlink.EKF_POS_HORIZ_ABS | mavlink.EKF_POS_VERT_ABS | mavlink.EKF_PRED_POS_HORIZ_ABS
)  # fmt: skip
_LOST = mavlink.EKF_ATTITUDE | mavlink.EKF_VELOCITY_VERT | mavlink.EKF_POS_VERT_ABS | mavlink.EKF_CONST_POS_MODE


@dataclass(slots=True)
class Estimate:
    """Estimated pose and velocity: ENU about the fleet's origin; yaw in radians from east."""

    position: Vector = (0.0, 0.0, 0.0)
    velocity: Vector = (0.0, 0.0, 0.0)
    yaw: float = 0.0


class SimulatedEstimator:
    """Simulated EKF. `boot` in seconds; `noise` (m) of its own GPS.

    `say(severity, text)` sends a STATUSTEXT. `resets_datum`: the first pose after the origin resets the height
    datum."""

    def __init__(
        self,
        params: SimulatedParameters,
        frame: LocalFrame,
        boot: float,
        noise: float,
        seed: str,
        report_text: Callable[[int, str], None],
        fault_state: FaultState | None = None,
        resets_datum: bool = True,
    ) -> None:
        self._resets_datum = resets_datum
        self._datum: float | None = None  # m: the vehicle's height above the origin when the height datum was reset
        self._params, self._frame, self._boot, self._report_text = params, frame, boot, report_text
        self._random = random.Random(seed)
        self._own = OwnGps(noise, fault_state or FaultState(), self._random)
        turn = self._random.uniform(0.0, math.tau)
        self._settle = random.Random(f"{seed}/imus").uniform(0.0, IMUS_SETTLE * boot)
        self._settled = math.inf  # time from which on its IMUs agree
        self._bias: Vector = (BIAS * math.cos(turn), BIAS * math.sin(turn), 0.0)
        self._error: Vector = (0.0, 0.0, 0.0)
        self._drift: Vector = (0.0, 0.0, 0.0)  # m/s, the error's rate
        self._yaw_error = 0.0
        self._past: deque[tuple[float, Vector]] = deque(maxlen=128)
        self._arrivals: deque[float] = deque(maxlen=6)
        self._fed: float | None = None  # time since which measurements arrive without a gap
        self._measured = -math.inf
        self._gps_time = (-1, -1)
        self.estimate = Estimate()
        self.started: float | None = None
        self.initialised = False
        self.ready = False
        self.origin: LocalFrame | None = None  # the EKF's own origin; differs from robot to robot
        self.place: Vector = (0.0, 0.0, 0.0)  # the origin as latitude and longitude (degrees) and altitude (m)

    @property
    def source(self) -> str:
        """Position source: "own" (GPS), "gps_input", "vision", or "" for none."""
        params = self._params
        if params.of("EK3_SRC1_POSXY") == VISION:
            return "vision" if params.of("VISO_TYPE") == 1 else ""
        if params.of("EK3_SRC1_POSXY") != GPS or params.of("GPS1_TYPE") == 0:
            return ""
        return "gps_input" if params.of("GPS1_TYPE") == 14 else "own"

    @property
    def flags(self) -> int:
        """Flags of EKF_STATUS_REPORT."""
        if not self.initialised:
            return int(mavlink.EKF_UNINITIALIZED)
        return int(_READY if self.ready else _LOST)

    def fault(self, now: float) -> str:
        """Return why the estimator prevents arming; "" if it does not."""
        source = self.source
        if source == "gps_input" and self.initialised:
            if now - self._measured > 1.0:
                return "GPS 1: Bad fix"
            if self._period() > HEALTHY_PERIOD:
                return "GPS 1: not healthy"
        if source == "vision" and self.initialised and now - self._measured > VISION_PERIOD:
            return "VisOdom: not healthy"
        if not self.ready:
            return "Need Position Estimate"
        return "" if now >= self._settled else "Accels inconsistent"

    def step(self, truth: BodyState, now: float, dt: float) -> None:
        """Move the estimate with the true motion, as gyros and accelerometers do, and let its error grow."""
        if self.started is None:
            self.started = now
        own = self.source == "own"
        if own:
            self._error = self._own.error(truth, now, dt, self._bias)
        elif math.isfinite(self._measured):
            self._drift = _plus(self._drift, self._bias, dt)
            self._error = _plus(self._error, self._drift, dt)
        estimate = self.estimate
        estimate.position = _plus(truth.position, self._error, 1.0)
        estimate.velocity = truth.velocity if own else _plus(truth.velocity, self._drift, 1.0)
        estimate.yaw = truth.yaw + self._yaw_error
        if not own:
            self._past.append((now, estimate.position))
        if not self.ready or not own or self._own.fault_state.positioning.dropout:
            self._progress(now, now - self.started)

    def _progress(self, now: float, age: float) -> None:
        source = self.source
        if not self.initialised:
            if age < INITIALISED * self._boot:
                return
            self.initialised = True
            self._report_text(mavlink.MAV_SEVERITY_INFO, "EKF3 IMU0 initialised")
        lost = now - self._own.fixed > OWN_LOST if source == "own" else now - self._measured > LOST
        if self.ready:
            self.ready = not lost
            return
        fed = -math.inf if self._fed is None or lost else now - self._fed
        match source:
            case "own":
                self.ready = age >= self._boot and not lost
            case "gps_input":
                self.ready = age >= self._boot and fed >= CHECKS * self._boot and self._period() <= HEALTHY_PERIOD
            case "vision":
                self.ready = age >= VISION_READY * self._boot and fed >= 0.5 and self.origin is not None
        if self.ready:
            self._settled = min(self._settled, now + self._settle)
            self._report_text(
                mavlink.MAV_SEVERITY_INFO,
                "EKF3 IMU0 is using external nav data" if source == "vision" else "EKF3 IMU0 is using GPS",
            )
            if self.origin is None:
                self._set_origin(self._frame.geodetic(*self.estimate.position))

    def _set_origin(self, place: Vector) -> None:
        self.place, self.origin = place, LocalFrame(*place)
        self._report_text(mavlink.MAV_SEVERITY_INFO, "EKF3 IMU0 origin set")

    def receive_origin(self, message: mavlink.MAVLink_set_gps_global_origin_message) -> None:
        """Handle SET_GPS_GLOBAL_ORIGIN. Before initialisation it is lost; a second one changes nothing."""
        latitude, longitude = message.latitude * 1e-7, message.longitude * 1e-7
        if self.initialised and self.origin is None and abs(latitude) <= 90 and abs(longitude) <= 180:
            self._set_origin((latitude, longitude, message.altitude * 1e-3))

    def receive_gps(self, message: mavlink.MAVLink_gps_input_message, now: float) -> None:
        """Handle GPS_INPUT."""
        time = message.time_week, message.time_week_ms
        if self.source != "gps_input" or message.fix_type < 3 or not math.isfinite(message.alt):
            return
        if time <= self._gps_time:
            return
        self._gps_time = time
        place = self._frame.enu(message.lat * 1e-7, message.lon * 1e-7, message.alt)
        yaw = None
        source = self._params.of("EK3_SRC1_YAW")
        if source in (GPS_YAW, GPS_OR_COMPASS_YAW) and 1 <= message.yaw <= 36000:
            yaw = math.pi / 2 - math.radians(message.yaw / 100)
        elif source == GPS_YAW:
            return  # without a yaw the EKF does not start
        delay = self._params.of("GPS1_DELAY_MS") / 1000 or DEFAULT_GPS_DELAY
        self._correct(place, yaw, delay, 1.0, now)

    def receive_vision(self, position: Vector, yaw: float, now: float) -> None:
        """Handle VISION_POSITION_ESTIMATE or ODOMETRY: NED about the EKF's origin, yaw from north."""
        if self.source != "vision" or self.origin is None or not all(map(math.isfinite, (*position, yaw))):
            return
        north, east, down = position
        if self._datum is None:
            self._datum = -down if self._resets_datum else 0.0
        place = self._frame.enu(*self.origin.geodetic(east, north, self._datum - down))
        heading = math.pi / 2 - yaw if self._params.of("EK3_SRC1_YAW") == VISION else None
        self._correct(place, heading, self._params.of("VISO_DELAY_MS") / 1000, VISION_PERIOD, now)

    def _correct(self, place: Vector, yaw: float | None, delay: float, gap: float, now: float) -> None:
        """Correct the estimate by a measurement that is `delay` seconds old."""
        since = now - self._measured
        if since > gap:
            self._fed = now
            self._arrivals.clear()
        if since > LOST:  # no estimate left to correct: restart at the measurement
            self._error = _plus(self._error, _plus(place, self.estimate.position, -1.0), 1.0)
            self._drift = (0.0, 0.0, 0.0)
        else:
            innovation = _plus(place, self._position_at(now - delay), -1.0)
            self._error = _plus(self._error, innovation, POSITION_SHARE)
            self._drift = _plus(self._drift, innovation, VELOCITY_SHARE / max(since, 0.02))
        if yaw is not None:
            share = 1.0 if since > LOST else POSITION_SHARE
            self._yaw_error += share * math.remainder(yaw - self.estimate.yaw, math.tau)
        self._arrivals.append(now)
        self._measured = now

    def _position_at(self, time: float) -> Vector:
        """Return the position that was estimated at `time`."""
        for at, position in reversed(self._past):
            if at <= time:
                return position
        return self._past[0][1] if self._past else self.estimate.position

    def _period(self) -> float:
        """Return the mean time between two measurements, in seconds."""
        if len(self._arrivals) < 2:
            return math.inf
        return (self._arrivals[-1] - self._arrivals[0]) / (len(self._arrivals) - 1)


def _plus(a: Vector, b: Vector, share: float) -> Vector:
    """Return a + share * b."""
    return a[0] + share * b[0], a[1] + share * b[1], a[2] + share * b[2]
