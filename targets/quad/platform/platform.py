"""Platform of a multicopter with an ArduPilot or PX4 autopilot, which it controls over MAVLink 2.

It serves the modules Motion and MotionWithScan:

Sensors `position` and `velocity`: the autopilot's estimate.
Actuator `target`: the quad flies to it in a straight line, at `max_speed` at most and at `flight_height` or above.
Actuator `path`: the quad flies to the path's points one after the other.
Sensor `reached`: true if the quad has arrived and stands still.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Annotated, Any, Literal

import msgspec

from koordgen.runtime.config.settings import BadSettings, Settings
from koordgen.runtime.values.geodesy import LocalFrame
from koordgen.runtime.values.points import Point, transmissible
from koordgen.runtime.vehicle.datagrams import DatagramLink
from koordgen.runtime.vehicle.feed import listen_for_poses
from koordgen.runtime.vehicle.platform import Finding, Sensed, Unready, Vitals
from koordgen.runtime.vehicle.safety import clamp, inside
from koordgen.runtime.vehicle.scans import ScanPort, listen_for_scans
from targets.mavlink.framing import Message
from targets.mavlink.link import Link
from targets.mavlink.parameters import Wanted
from targets.mavlink.transport import Transport, opened
from targets.planning.process import Beside
from targets.planning.route import commanded, passed
from targets.planning.standstill import Unplanned
from targets.quad.autopilot.check import listen
from targets.quad.autopilot.diagnosis import checks
from targets.quad.autopilot.firmware import Firmware
from targets.quad.autopilot.flight import Flight, FlightPhase
from targets.quad.autopilot.positioning import Positioning
from targets.quad.autopilot.telemetry import Telemetry
from targets.quad.motion.avoidance import MakePlanning, QuadAvoidance, Size
from targets.quad.motion.landing import Landing
from targets.quad.motion.motion import Motion
from targets.quad.motion.setpoint import Aim, setpoint
from targets.quad.motion.yaw import heading

MODULES = ("Motion", "MotionWithScan")  # both modules control the same vehicle; MotionWithScan adds a lidar


class Body(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of a quad in the fleet file (`settings:`). manifest.toml explains each setting."""

    autopilot: str = "udpin:127.0.0.1:14550"
    flight_height: Annotated[float, msgspec.Meta(ge=0.3, le=100.0)] = 1.5
    max_speed: Annotated[float, msgspec.Meta(ge=0.1, le=15.0)] = 1.0
    max_acceleration: Annotated[float, msgspec.Meta(ge=0.1, le=5.0)] = 1.0
    max_climb: Annotated[float, msgspec.Meta(ge=0.1, le=5.0)] = 0.7
    yaw: str = "keep"
    reached_radius: Annotated[float, msgspec.Meta(ge=0.01, le=5.0)] = 0.15
    reached_dwell: Annotated[float, msgspec.Meta(ge=0.0, le=60.0)] = 0.3
    scans: str = ""
    radius: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)] = 0.2
    tracking_error: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)] = 0.1
    position_error: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)] = 0.05
    clearance: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)] = 0.3
    planner: str = "rrt-smoothed"
    positioning: Literal["own", "gps_input", "vision", "odometry"] = "own"
    feed: str = "udp:0.0.0.0:47300"
    system: Annotated[int, msgspec.Meta(ge=0, le=255)] = 0
    allow_no_failsafe: bool = False


def _bind(setting: str) -> DatagramLink:
    return listen_for_poses("feed", setting)


class Quad:
    """Platform of a quad: implements koordgen.runtime.vehicle.platform.Platform.

    `key`: the fleet's key, which authenticates the position feed and the lidar's scans. The link to the autopilot needs
    no key, because it is a wire or the loopback interface.
    `connect`, `bind`, `scans`: functions that open the links to the autopilot, the position feed and the lidar.
    `wall`: function that returns the time of day. `clock`, `sleep`: used by `diagnose` only.
    `planning`: makes the planner. A simulator passes its own links, clocks and planner.
    """

    period = 0.05

    def __init__(
        self,
        settings: Settings,
        key: bytes | None,
        *,
        connect: Callable[[str], Transport] = opened,
        bind: Callable[[str], DatagramLink] = _bind,
        scans: Callable[[str], DatagramLink] = listen_for_scans,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
        wall: Callable[[], float] = time.time,
        planning: MakePlanning = Beside,
    ) -> None:
        try:
            body = msgspec.convert(settings.body, Body)
        except msgspec.ValidationError as error:
            raise BadSettings(f"settings of {settings.robot}: body: {error}") from None
        fence, origin = settings.geofence, settings.origin
        if clamp(fence, Point(0.0, 0.0, body.flight_height)).z != body.flight_height:
            raise BadSettings(
                f"settings of {settings.robot}: body: flight_height {body.flight_height:g} is outside the geofence"
            )
        self._body, self._fence = body, fence
        self._frame = LocalFrame(origin.latitude, origin.longitude, origin.altitude)
        self._telemetry = Telemetry(self._frame)
        try:
            yaw = heading(body.yaw)
        except ValueError:
            raise BadSettings(
                f"settings of {settings.robot}: body: yaw {body.yaw!r} is not keep, forward or an angle"
            ) from None
        size = Size(body.radius, body.tracking_error, body.position_error)
        self._avoidance = QuadAvoidance(settings, body.flight_height, size, body.clearance, body.planner, planning)
        self._motion = Motion(
            self._frame, fence, body.flight_height, body.max_speed, body.max_acceleration, body.max_climb,
            body.reached_radius, body.reached_dwell, yaw, space=self._avoidance, action=settings.safety.missed_action,
        )  # fmt: skip
        self._landing = Landing(settings.pid, self._avoidance.spacing, self._avoidance)
        self._steered = False  # whether the last poll steered the quad by a trusted position
        self._connect, self._clock, self._sleep, self._wall = connect, clock, sleep, wall
        self._lidar = ScanPort(body.scans, settings.robot, key, scans)
        self._positioning: Positioning | None = None  # None: the autopilot has its own position source
        if body.positioning != "own":
            self._positioning = Positioning(
                body.positioning, body.feed, settings, key, self._frame, body.max_speed, bind, wall
            )
        self._link: Link | None = None
        self._flight: Flight | None = None
        self._held = False
        self._now = 0.0
        self._unplanned = Unplanned()

    def diagnose(self) -> list[Finding]:
        """Check the autopilot, the position feed, the planner and the lidar. Return the results.

        During the check, the samples of a position feed are forwarded to the autopilot."""
        vehicle = self._diagnose_vehicle()
        return [*vehicle, self._avoidance.diagnose(self._sleep), *self._lidar.diagnose(self._sleep)]

    def _diagnose_vehicle(self) -> list[Finding]:
        url, positioning = self._body.autopilot, self._positioning
        try:
            link = Link(self._connect(url), self._body.system)
        except Unready as error:
            return [Finding.of("link", error)]

        def meanwhile(messages: list[Message], now: float) -> None:
            if positioning is not None:
                positioning.attend(link, messages, now)

        fed: list[Finding] = []
        try:
            if positioning is not None:
                fed = positioning.tried(self._clock())
            heard = listen(link, self._frame, self._wanted, meanwhile, self._clock, self._sleep, self._wall)
        except Unready as error:
            return [Finding.of("positioning", error)]
        finally:
            link.close()
            if positioning is not None:
                positioning.close()
        if positioning is not None and not fed:
            fed = positioning.checks(heard.telemetry, self._clock())
        return [*fed, *checks(url, heard, self._frame, self._fence, self._body.flight_height)]

    def start(self, now: float) -> None:
        """Open the links to the robot's devices, and start the planner. `poll` then takes off. Raises Unready."""
        url = self._body.autopilot
        self._now = now
        self._avoidance.start()
        self._lidar.open()
        if self._positioning is not None:
            self._positioning.open(now)
        self._link = Link(self._connect(url), self._body.system)
        self._flight = Flight(
            url, self._link, self._telemetry, self._fence, self._body.flight_height, self._body.max_climb, self._go_to,
            self._wanted, now,
        )  # fmt: skip
        self._flight.grounded = self._held

    def _go_to(self, p: Point) -> None:
        if self._link is not None and self._link.vehicle is not None:
            self._link.send(setpoint(self._link.vehicle, self._frame, self._fence, Aim(p)))

    def _wanted(self, firmware: Firmware) -> tuple[Wanted, ...]:
        """Return the autopilot's parameters that the agent checks, for this firmware and this quad's settings."""
        fed = self._positioning.wanted(firmware) if self._positioning is not None else ()
        if self._body.allow_no_failsafe:
            return (*(replace(w, vital=False) for w in firmware.parameters), *fed)
        return (*firmware.parameters, *fed)

    def poll(self, now: float) -> None:
        """Receive telemetry and feeds, supervise the flight, and send the next setpoint. Raises Unready."""
        if self._flight is None or self._link is None:
            raise Unready("the quad was not started")
        self._now, self._steered = now, False
        self._lidar.poll(now)
        self._avoidance.poll()
        self._flight.poll(now)
        if self._positioning is not None:
            self._positioning.poll(self._link, self._flight, self._telemetry, now)
            self._motion.hold(self._held or self._positioning.held, now)
        if self._flight.phase is FlightPhase.CLIMBING:
            self._motion.rise(self._telemetry, now)
        elif self._flight.phase is not FlightPhase.FLYING:
            self._motion.coast(now)
        elif self._telemetry.fresh(now):
            self._motion.steer(self._link, self._telemetry, now)
            self._steered = self._positioning is None or not self._positioning.held
        else:
            self._motion.halt(self._link, now)

    @property
    def ready(self) -> bool:
        """True if the quad hovers at flight height and can begin its mission.

        The mission requires a live link to the autopilot, a fresh position, an autopilot that follows setpoints, lidar
        scans if there is a lidar, a planner, and a trusted position source."""
        return (
            self._flight is not None
            and self._flight.phase is FlightPhase.FLYING
            and self._link is not None
            and self._link.alive(self._now)
            and self._telemetry.fresh(self._now)
            and self._motion.followed
            and self._motion.settled
            and not self._lidar.waiting
            and not self._avoidance.waiting
            and (self._positioning is None or not self._positioning.held)
        )

    @property
    def progress(self) -> str:
        """Present activity of the quad, for the log. Includes the autopilot's reasons for refusing to arm."""
        if self._flight is None:
            return "not started"
        refused = f"; {self._motion.refused} targets were not finite" if self._motion.refused else ""
        waiting = "".join(f"; {what}" for what in (self._lidar.waiting, self._avoidance.waiting) if what)
        doubt = f"; {self._positioning.doubt}" if self._positioning is not None and self._positioning.doubt else ""
        return self._flight.progress + doubt + waiting + refused

    @property
    def stall(self) -> str:
        """Reason why the quad has no path to the commanded place, in words.

        It is "" if the quad has a path, is held, or has landed."""
        if self._held or self.stopped:
            return ""
        idle = self._unplanned.why(self._now) if self._motion.reached else ""
        return self._avoidance.refusal or self._motion.stall or idle

    def sense(self, now: float) -> Sensed:
        """Return the present sensor values.

        Before the autopilot's first estimate, the position is the origin and `time` is None."""
        state = self._telemetry
        reached = self._motion.reached and not self._avoidance.refusal
        ports = {"position": state.position or Point(), "velocity": state.velocity, "reached": reached}
        values: dict[str, Any] = {f"{module}.{port}": value for module in MODULES for port, value in ports.items()}
        values["MotionWithScan.pscan"] = self._lidar.scans.recent(now)
        return Sensed(values, self._vouched)

    @property
    def vitals(self) -> Vitals:
        """Yaw (rad from east) and battery charge (0 to 1) of the quad; None for an unknown value."""
        return Vitals(self._telemetry.yaw, self._telemetry.battery)

    @property
    def _vouched(self) -> float | None:
        """Time of the last trusted position, in seconds on the agent's clock; None before the first one.

        The autopilot has reported this position. External positioning must have confirmed it, too."""
        told = self._telemetry.time
        if self._positioning is None or told is None:
            return told
        return None if self._positioning.vouched is None else min(told, self._positioning.vouched)

    def command(self, actuators: Mapping[str, Any], now: float) -> None:
        """Fly to the target or along the path that the program commands.

        A command that is not finite is refused and counted; `progress` reports the count. If the way leads into an
        obstacle of the fleet file, the quad holds instead, and `stall` gives the reason."""
        for points in commanded(actuators, MODULES):
            self._command(points, now)

    def resume(self, actuators: Mapping[str, Any], now: float) -> None:
        """Continue the path that the agent followed before its restart.

        If the straight leg to the path's next point is not clear of obstacles, the planner plans a leg."""
        position = self._telemetry.position
        for points in commanded(actuators, MODULES):
            if position is not None and points and transmissible(points):
                self._command(points, now, passed(points, position))
            else:
                self._command(points, now)

    def _command(self, points: tuple[Point, ...], now: float, behind: int | None = None) -> None:
        """Fly along these points if the path is clear of obstacles, else hold.

        `behind`: number of points that a resumed quad has passed; None for a new command."""
        if points:
            self._unplanned.commanded()
        held, avoidance = self._avoidance.refusal, self._avoidance
        if behind is None:
            admitted = avoidance.admits(self._telemetry.position, points)
        else:
            admitted = avoidance.resumes(points, behind)
        if admitted:
            self._motion.command(points, now, behind)
        elif not held:
            self._motion.command((), now)

    def call(self, port: str, args: tuple[Any, ...]) -> Any:
        """Answer a call of `planner(goal, obstacles)`, the only callable port, with the planned path."""
        path = self._avoidance.plan(self._telemetry.position, args[0], args[1] if len(args) > 1 else ())
        self._unplanned.called(args[0], self._avoidance.unplanned, self._now)
        return path

    def others(self, paths: Mapping[int, tuple[Point, ...]]) -> None:
        """Store the paths that the other robots have published, by their pids."""
        self._avoidance.others(paths)

    def log_lines(self) -> list[str]:
        """Return the log lines of positioning, planner, motion control and landing since the last call."""
        told = self._positioning.log_lines() if self._positioning is not None else []
        return [*told, *self._avoidance.log_lines(), *self._motion.log_lines(), *self._landing.log_lines()]

    def hold(self, on: bool, now: float) -> None:
        """Hold the position, or end the hold. A held quad on the ground does not take off."""
        self._held = on
        self._motion.hold(on or (self._positioning is not None and self._positioning.held), now)
        if self._flight is not None:
            self._flight.grounded = on

    def stop(self, now: float) -> None:
        """Make the safe stop: land, away from the positions and paths that other robots have published.

        If a pilot or a failsafe has taken over the vehicle, the agent sends it no more commands."""
        if self._flight is not None and not self._moves_aside(now):
            self._flight.stop(now)

    def _moves_aside(self, now: float) -> bool:
        """Return whether the quad first flies to another landing place, because another robot may be below it."""
        position = self._telemetry.position
        if not self._steered or position is None or not inside(self._fence, position):
            return False
        place = self._landing.aside(position, self._telemetry.velocity, self._avoidance.published, now)
        if place is not None:
            self._held = False
            self._motion.hold(False, now)
            self._motion.command((place,), now)
        return place is not None

    @property
    def stopped(self) -> bool:
        """True if the quad's part of the mission has ended.

        The quad has landed and disarmed, was taken over by a pilot or a failsafe, or was never commanded."""
        return self._flight is None or self._flight.phase is FlightPhase.STOPPED

    def close(self) -> None:
        """Close the links to the robot's devices, and end the planner's process."""
        if self._link is not None:
            self._link.close()
            self._link = None
        self._lidar.close()
        self._avoidance.close()
        if self._positioning is not None:
            self._positioning.close()
