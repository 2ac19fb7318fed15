"""Platform of the car: serves the ports of Motion and MotionWithScan as a state machine that is polled at 20 Hz.

`position` is the middle of the rear axle, in local ENU, with z = 0. The car brings this point to a target, whose z is
ignored. The position feed must report this point, too.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from koordgen.runtime.config.settings import Settings
from koordgen.runtime.values.geodesy import LocalFrame
from koordgen.runtime.values.points import Point, Pose, transmissible
from koordgen.runtime.vehicle.datagrams import DatagramLink, waiting
from koordgen.runtime.vehicle.feed import Feed
from koordgen.runtime.vehicle.platform import Finding, Sensed, Unready, Vitals
from koordgen.runtime.vehicle.scans import ScanPort
from targets.car.base.settings import FROM_DRIVE, decode
from targets.car.control.estimator import Estimator
from targets.car.control.fence import braked, stops_inside
from targets.car.control.lag import LONGEST_LAG, Lag, is_long
from targets.car.control.mpc import STEP, Command
from targets.car.control.navigator import STANDING, Navigator
from targets.car.drive.drive import Drive, opened
from targets.car.drive.links import Links, RealLinks
from targets.car.planning.avoidance import CarAvoidance, MakePlanning
from targets.car.platform.diagnosis import (
    STALE,
    check_drive,
    check_feed,
    check_fixes,
    check_lag,
    check_watchdog,
    limits,
    slow,
)
from targets.planning.process import Beside
from targets.planning.route import Route, commanded, passed
from targets.planning.standstill import Standstill, Unplanned

MODULES = ("Motion", "MotionWithScan")  # modules of a car without and with a lidar
WAIT_FOR_FEED = 60.0  # seconds to wait for the first position: a base station may be started after the robots
JUMPED = 1.0  # seconds of position samples that all jumped, after which the position source counts as failed
BLIND_BRAKING = 1.5  # seconds of braking after which a car whose speed is unknown counts as standing
STILL = 0.3  # seconds at standstill after which a safe stop is complete
PASSED = 0.4  # metres from an intermediate point at which the car goes on to the next; only the last point is reached
SLACK = 0.005  # seconds by which a poll may be early and still run the controller, because polls jitter


class Car:
    """Platform of an F1/10-class car: implements koordgen.runtime.vehicle.platform.Platform."""

    period = STEP

    def __init__(
        self,
        settings: Settings,
        key: bytes | None,
        links: Links | None = None,
        planning: MakePlanning = Beside,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        """`clock` measures the run time of the controller's solver."""
        self._settings = decode(settings.body)
        self._fence = settings.geofence
        self._links: Links = links if links is not None else RealLinks(_notes(settings))
        self._frame = LocalFrame(settings.origin.latitude, settings.origin.longitude, settings.origin.altitude)
        self._robot, self._key, self._clock = settings.robot, key, clock
        self._application = settings.application_id
        self._feed = Feed(settings.robot, key, settings.application_id)
        self._lidar = ScanPort(self._settings.scans, settings.robot, key, self._links.scans)
        own = self._settings
        self._estimator = Estimator(own.wheelbase, own.max_speed, own.steering_limit)
        self._datagrams: DatagramLink | None = None
        self._drive: Drive | None = None
        self._navigator: Navigator | None = None
        self._route = Route()
        self._avoidance = CarAvoidance(settings, own, planning)
        self._standstill = Standstill(settings.safety.missed_action)
        self._now = 0.0
        self._started = 0.0
        self._next_control = -math.inf
        self._still_since: float | None = None
        self._stopping_since: float | None = None
        self._holding = False
        self._blocked = ""  # reason why the car brakes, in words; "" if it does not brake
        self._unplanned = Unplanned()
        self._lag = Lag()
        self._slow: bool | None = None  # whether the motor's last estimated lag is too long; None: unknown
        self._stood = False  # whether the car stood when the position source began to jump
        self._log_lines: list[str] = []

    def diagnose(self) -> list[Finding]:
        """Implement `Platform.diagnose`."""
        found = [*check_drive(self._settings, self._links, self._frame), check_watchdog(self._links)]
        if self._settings.position == FROM_DRIVE:
            found += check_fixes(self._settings, self._fence, self._links, self._frame)
        else:
            feed = Feed(self._robot, self._key, self._application)
            found += check_feed(self._settings, self._fence, feed, self._links)
        found += [
            limits(self._settings, self._fence),
            *check_lag(self._links.remembered()),
            self._loaded(),
            self._avoidance.diagnose(self._links.wait),
        ]
        return [*found, *self._lidar.diagnose(self._links.wait)]

    def _loaded(self) -> Finding:
        try:
            note = self._build().note
        except Unready as error:
            return Finding.of("controller", error)
        if note:
            return Finding("controller", "warn", note, "the MPC in C", "install a C compiler: apt install gcc")
        return Finding("controller", "ok", "the MPC loads")

    def start(self, now: float) -> None:
        # Before the links are opened, because their buffers would fill while the solver compiles.
        self._navigator = self._build()
        if self._navigator.note:
            self._log_lines.append(self._navigator.note)
        self._open()
        self._avoidance.start()
        self._now = self._started = now

    def _open(self) -> tuple[Drive, DatagramLink]:
        """Open the links that are not open yet; the sockets first, because a VESC's port opens slowly."""
        if self._datagrams is None:
            self._datagrams = self._links.position(self._settings.position)
            self._feed.hear(self._datagrams)
        self._lidar.open()
        if self._drive is None:
            self._drive = opened(self._settings, self._links, self._frame)
        return self._drive, self._datagrams

    def _build(self) -> Navigator:
        try:
            return Navigator(self._settings, self._avoidance.area, self._avoidance, self._clock)
        except ImportError as error:
            hint = "install the bundle's requirements.txt (64-bit systems only)"
            raise Unready(f"a package is missing: {error}", hint) from None

    def poll(self, now: float) -> None:
        self._now = now
        self._lidar.poll(now)
        try:
            self._avoidance.poll()
            drive = self._read(now)
        except Unready:
            if self._drive is not None:
                with suppress(Unready):  # a drive that no longer answers may still receive commands
                    self._drive.brake(now)
            raise
        if now < self._next_control - SLACK:
            return
        self._next_control = max(self._next_control, now) + STEP
        self._control(drive, now)

    def _read(self, now: float) -> Drive:
        drive, datagrams = self._opened()
        speed = drive.read(now)
        if speed is not None:
            self._estimator.wheels(speed, now)
        steering = self._navigator.steering if self._navigator else 0.0
        self._estimator.predict(now, steering)
        for datagram in waiting(datagrams):
            if self._feed.receive(datagram, now) and self._feed.pose is not None and self._feed.time is not None:
                self._locate(self._feed.pose, self._feed.time, now)
        for pose, measured in drive.fixes():
            self._locate(pose, measured, now)
        self._wait_for_positions(now)
        moving = self._estimator.speed(now)
        if moving is None or abs(moving) > STANDING:
            self._still_since = None
        elif self._still_since is None:
            self._still_since = now
        return drive

    def _opened(self) -> tuple[Drive, DatagramLink]:
        if self._drive is None or self._datagrams is None:
            raise Unready("the car's links are closed")
        return self._drive, self._datagrams

    def _locate(self, pose: Pose, measured: float, now: float) -> None:
        """Process a sample of the position source. A sample that jumps is rejected and counted."""
        believed = self._estimator.refused(now) == 0.0
        if self._estimator.correct(pose, measured, now):
            return
        self._feed.reject("jumped")
        if believed:
            self._stood = self._still_since is not None and now - self._still_since >= JUMPED

    def _wait_for_positions(self, now: float) -> None:
        waited = now - self._started
        if self._stopping_since is not None:
            return
        if self._estimator.time is None and waited > WAIT_FOR_FEED:
            raise self._no_position(waited)
        if self._estimator.refused(now) <= JUMPED:
            return
        if not self._stood:
            hint = "check whether the motion capture system confuses this car with another body or its mirror image"
            raise Unready(f"position source jumped: {self._jump} and nothing else came for {JUMPED:g} s", hint)
        self._estimator.begin_anew()
        self._log_lines.append(
            f"the car stood, and the position source jumped by {self._estimator.jumped:.1f} m: accepted"
        )

    def _no_position(self, waited: float) -> Unready:
        if self._settings.position == FROM_DRIVE:
            hint = "check that the rover's EKF has position and heading, or give the car a position feed"
            return Unready(f"the rover has not reported its position for {waited:.0f} s", hint)
        return Unready(*self._feed.silent(self._settings.position, waited))

    @property
    def _jump(self) -> str:
        return f"a sample was {self._estimator.jumped:.1f} m off{self._feed.dropped}"

    def _control(self, drive: Drive, now: float) -> None:
        navigator = self._navigator
        if navigator is None:
            return
        self._blocked = self._obstacle(drive, now)
        standing = self._still_since is not None
        if self._blocked:
            self._stands_still(navigator, False, now)
            navigator.pause()
            navigator.watch(self._estimator.state, standing and self._fresh(now), now)
            drive.brake(now)
            return
        self._follow(navigator)
        command = navigator.step(self._estimator.state, standing, now)
        if command is None:
            self._stands_still(navigator, False, now)
            drive.brake(now)
        elif ahead := self._ahead(command):
            self._blocked = f"braking: {ahead} is ahead"
            navigator.pause()
            drive.brake(now)
        elif self._stands_still(navigator, True, now):
            navigator.pause()
            drive.brake(now)
        else:
            drive.go(command, self._estimator.speed(now), now)
            self._lag.note(drive.asked, self._estimator.speed(now), now)
            self._judge_lag()
            return
        self._lag.reset()

    def _judge_lag(self) -> None:
        """Log when the motor's lag becomes too long for the controller, and when it is short enough again."""
        lag = self._lag.seconds
        if lag is None or self._slow == is_long(lag):
            return
        before, self._slow = self._slow, is_long(lag)
        self._links.remember(lag)
        if self._slow:
            self._log_lines.append(slow(lag))
        elif before:
            self._log_lines.append(f"the motor follows its commands within {lag:.1f} s again")

    def _stands_still(self, navigator: Navigator, drives: bool, now: float) -> bool:
        """Return whether the car must brake because it stands still although it is driven."""
        state, target = self._estimator.state, navigator.target
        goal = "no target" if target is None else f"({target[0]:.2f}, {target[1]:.2f})"
        return self._standstill.look(Point(state.x, state.y, 0.0), drives and not navigator.waits, goal, now)

    def _ahead(self, command: Command) -> str:
        """Return the name of the geofence or obstacle that the car could not avoid after this command; "" if none.

        The car could not avoid it if it reaches it even if it brakes. Obstacles are those of the fleet file."""
        own, state = self._settings, self._estimator.state
        if not stops_inside(self._fence, state, command, own.braking, own.wheelbase):
            return "the geofence"
        return self._avoidance.ahead(state, braked(state, command, own.braking, own.wheelbase))

    def _follow(self, navigator: Navigator) -> None:
        """Go on to the next point of the commanded path if the car is near the present point."""
        goal, state = self._route.goal, self._estimator.state
        if goal is None or self._route.last or math.dist((state.x, state.y), (goal.x, goal.y)) >= PASSED:
            return
        if (following := self._route.passed()) is not None:
            navigator.go_to((following.x, following.y))

    def _obstacle(self, drive: Drive, now: float) -> str:
        """Return the reason why the car must not drive now, in words; "" if it may drive."""
        if self._stopping_since is not None:
            return "at rest" if self.stopped else "braking to rest"
        if drive.blocked:
            return drive.blocked
        if self._estimator.time is None:
            return f"waiting for the position feed on {self._settings.position}{self._feed.dropped}"
        if not self._fresh(now):
            if self._estimator.refused(now):
                return f"braking: the position source jumped: {self._jump}"
            return f"braking: the position is {now - self._estimator.time:.1f} s old{self._feed.dropped}"
        return "holding" if self._holding else self._standstill.holding

    def _fresh(self, now: float) -> bool:
        time = self._estimator.time
        return time is not None and now - time <= STALE

    @property
    def ready(self) -> bool:
        if self._drive is None or self._drive.blocked:
            return False
        return self._fresh(self._now) and not self._lidar.waiting and not self._avoidance.waiting

    @property
    def progress(self) -> str:
        if self._navigator is None:
            return "not started"
        waiting = self._lidar.waiting or self._avoidance.waiting
        return self._blocked or waiting or self._avoidance.refusal or self._navigator.progress

    @property
    def stall(self) -> str:
        """Implement `Platform.stall`."""
        if self._navigator is None or self._stopping_since is not None or self._holding:
            return ""
        idle = self._unplanned.why(self._now) if self._navigator.reached else ""
        stall = self._navigator.stall
        if stall and self._slow:
            stall += f"; the motor's lag is {self._lag.seconds or 0.0:.1f} s, more than {LONGEST_LAG:g} s"
        return self._blocked or self._avoidance.refusal or stall or idle

    def sense(self, now: float) -> Sensed:
        """Return the filtered pose, extrapolated to `now`."""
        state = self._estimator.state
        position = Point(state.x, state.y, 0.0)
        speed = self._estimator.speed(now) or 0.0
        ports = {
            "position": position,
            "pose": Pose(position, state.yaw),
            "velocity": Point(speed * math.cos(state.yaw), speed * math.sin(state.yaw), 0.0),
            "reached": self._navigator is None
            or (self._navigator.reached and self._route.last and not self._avoidance.refusal and self._fresh(now)),
        }
        values: dict[str, Any] = {f"{module}.{port}": value for module in MODULES for port, value in ports.items()}
        values["MotionWithScan.pscan"] = self._lidar.scans.recent(now)
        return Sensed(values, self._estimator.time)

    @property
    def vitals(self) -> Vitals:
        """Yaw and battery charge, None if unknown. Implements `Examined.vitals`."""
        known = self._estimator.time is not None
        return Vitals(
            self._estimator.state.yaw if known else None, self._drive.battery if self._drive is not None else None
        )

    def command(self, actuators: Mapping[str, Any], now: float) -> None:
        if self._navigator is None:
            return
        for points in commanded(actuators, MODULES):
            self._go(points, self._navigator)

    def resume(self, actuators: Mapping[str, Any], now: float) -> None:
        """Resume a commanded path: paths to the points ahead are planned one after another. Implements `Resumes`."""
        if self._navigator is None:
            return
        state = self._estimator.state
        for points in commanded(actuators, MODULES):
            if not points or not transmissible(points):
                self._go(points, self._navigator)
                continue
            flat = tuple(Point(p.x, p.y, 0.0) for p in points)
            self._unplanned.commanded()
            self._avoidance.resumes(points)
            self._route.follow(points)
            self._standstill.command()
            self._route.skip(passed(flat, Point(state.x, state.y, 0.0)))
            if (goal := self._route.goal) is not None:
                self._navigator.go_to((goal.x, goal.y))

    def _go(self, points: tuple[Point, ...], navigator: Navigator) -> None:
        """Follow commanded points.

        If the planner returned these points, follow the drivable path that it planned with them. Otherwise, plan a path
        to each point. If the points lead into an obstacle of the fleet file, hold and report the obstacle."""
        if points:
            self._unplanned.commanded()
        held = self._avoidance.refusal
        if not self._avoidance.admits(points):
            if held:
                return
            points = ()
        if not self._route.follow(points):
            return
        self._standstill.command()
        state, goal = self._estimator.state, self._route.goal
        curve = self._avoidance.planned(state, points)
        if curve is None:
            navigator.go_to((state.x, state.y) if goal is None else (goal.x, goal.y))
            return
        while not self._route.last:
            self._route.passed()
        navigator.follow(curve, state)

    def call(self, port: str, args: tuple[Any, ...]) -> Any:
        """Call the only callable port, `planner(goal, obstacles)`. Implements `Platform.call`."""
        gear = self._navigator.gear if self._navigator is not None else 0
        path = self._avoidance.plan(self._estimator.state, gear, args[0], args[1] if len(args) > 1 else ())
        self._unplanned.called(args[0], self._avoidance.unplanned, self._now)
        return path

    def others(self, paths: Mapping[int, tuple[Point, ...]]) -> None:
        """Implement `Platform.others`."""
        self._avoidance.others(paths)

    def log_lines(self) -> list[str]:
        """Implement `Platform.log_lines`."""
        told, self._log_lines = (
            [*self._log_lines, *self._avoidance.log_lines(), *self._feed.log_lines(), *self._standstill.log_lines()],
            [],
        )
        return told + (self._drive.log_lines() if self._drive is not None else [])

    def hold(self, on: bool, now: float) -> None:
        self._holding = on

    def stop(self, now: float) -> None:
        if self._stopping_since is None:
            self._stopping_since = now

    @property
    def stopped(self) -> bool:
        """True once the car has stood for STILL seconds, or, with unknown speed, braked for BLIND_BRAKING seconds."""
        since = self._stopping_since
        if since is None:
            return False
        if self._still_since is not None:
            return self._now - max(since, self._still_since) >= STILL
        return self._estimator.speed(self._now) is None and self._now - since >= BLIND_BRAKING

    def close(self) -> None:
        if self._drive is not None:
            self._drive.close(standing=self.stopped or self._still_since is not None)
        if self._datagrams is not None:
            self._datagrams.close()
        self._drive = self._datagrams = None
        self._lidar.close()
        self._avoidance.close()


def _notes(settings: Settings) -> Path | None:
    """Return the file in which the motor's lag is stored; None if the settings name no folder for state."""
    if settings.state is None:
        return None
    return Path(__file__).resolve().parents[4] / settings.state / f"{settings.robot}.lag"
