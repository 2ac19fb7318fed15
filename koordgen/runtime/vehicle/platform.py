"""Platform interface, which a target implements: connects the ports of a program with the vehicle of one robot.

The agent is one poll loop. It calls `poll` at least every `period` seconds, and all other methods between two polls. No
method may sleep, or block for more than a few milliseconds; longer work runs in a separate process of the platform.
The time is an argument of each method, so that a simulator can control it. Frames: local ENU metres about the fleet's
origin, yaw in radians counter-clockwise from east."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Protocol, runtime_checkable

if TYPE_CHECKING:  # checks of a robot import this module even if third-party packages are missing
    from koordgen.runtime.values.points import Point


class Unready(Exception):
    """Raised if the vehicle cannot serve: a link, a device or a setting is wrong. `hint` describes how to fix it."""

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint


State = Literal["ok", "warn", "fail"]


@dataclass(frozen=True, slots=True)
class Finding:
    """Result of one check before a mission.

    `found`: the state that the check found, in a few words with units. After a check that did not pass, `wanted` is the
    right state (empty if obvious), and `why` describes the consequence and the fix."""

    name: str
    state: State
    found: str
    wanted: str = ""
    why: str = ""

    @staticmethod
    def of(name: str, error: Unready) -> Finding:
        """Return a failed check from the error that ended the check."""
        return Finding(name, "fail", error.message, why=error.hint)


@dataclass(frozen=True, slots=True)
class Sensed:
    """Values of the sensor ports at one time.

    `values`: "Module.port" -> value. `time`: time at which the robot's position was measured, in seconds of the agent's
    clock; None before the first position."""

    values: Mapping[str, Any]
    time: float | None


@dataclass(frozen=True, slots=True)
class Vitals:
    """State of a vehicle that operators are shown.

    `yaw`: radians, counter-clockwise from east. `battery`: charge from 0 to 1. None: unknown."""

    yaw: float | None = None
    battery: float | None = None


class Platform(Protocol):
    """Platform of one robot.

    For a check: `diagnose`, then `close`. For a mission: `start`, `poll` until `ready`, rounds, `stop`, `poll` until
    `stopped`, then `close`."""

    period: float  # seconds between two polls of the control loop

    def diagnose(self) -> list[Finding]:
        """Open all links and devices, check them, and close them, without moving the robot.

        Checks that depend on a failed check may be left out. A failed check raises no exception. Only this method may
        take long: up to 15 seconds."""
        ...

    def start(self, now: float) -> None:
        """Open the links and begin to make the vehicle ready for the mission: a quad takes off. Raises Unready."""
        ...

    def poll(self, now: float) -> None:
        """Read the links, run the controller, send its commands. Raises Unready if the vehicle cannot recover."""
        ...

    @property
    def ready(self) -> bool:
        """True if the vehicle can begin a mission, and its sensors have fresh values."""
        ...

    @property
    def progress(self) -> str:
        """Present activity of the vehicle in a few words for the log, such as "climbing"."""
        ...

    @property
    def stall(self) -> str:
        """Reason why the vehicle has no path to its commanded target: text that names the target, then the obstacle.

        "" while the vehicle has a path, needs no path, holds, or stops."""
        ...

    def sense(self, now: float) -> Sensed:
        """Return the values of all sensor ports that the target offers."""
        ...

    def command(self, actuators: Mapping[str, Any], now: float) -> None:
        """Execute the actuator values that an event wrote: "Module.port" -> value.

        All numbers are finite, and all Points are inside the geofence."""
        ...

    def call(self, port: str, args: tuple[Any, ...]) -> Any:
        """Return the answer of a callable port, such as "Motion.planner", within the calling event.

        A planner returns a tuple of Points; an empty tuple means that it found no path. An exception discards the
        event."""
        ...

    def others(self, paths: Mapping[int, tuple[Point, ...]]) -> None:
        """Store the paths that the other robots published (pid -> path) for calls of the next event.

        A path begins at the present or a past position of its robot. A path of one point: the robot stays there. A pid
        is missing if its robot has published no path."""
        ...

    def log_lines(self) -> list[str]:
        """Return log lines about new problems, since the last call, that do not end the mission."""
        ...

    def hold(self, on: bool, now: float) -> None:
        """Hold the present position if `on`, otherwise resume the last command. Idempotent.

        The agent may call this before `start`. A vehicle that holds then does not begin to move: a quad stays on the
        ground."""
        ...

    def stop(self, now: float) -> None:
        """Begin the safe stop: a quad lands, a car brakes and goes neutral. Idempotent. It cannot be undone."""
        ...

    @property
    def stopped(self) -> bool:
        """True as soon as the safe stop is complete."""
        ...

    def close(self) -> None:
        """Close all links and devices. The vehicle must then be stopped or in its own failsafe. Idempotent."""
        ...


@runtime_checkable
class Resumes(Protocol):
    """Platform that can resume a path midway after a restart. Other platforms receive the whole command again."""

    def resume(self, actuators: Mapping[str, Any], now: float) -> None:
        """Execute the commands that this robot had before its restart.

        All points of a path before the segment that is nearest to the robot count as passed. No planner has checked the
        way from the robot to the next point."""
        ...


@runtime_checkable
class Examined(Protocol):
    """Platform that reports the vehicle's yaw and battery charge."""

    @property
    def vitals(self) -> Vitals: ...


def vitals(platform: Platform) -> Vitals:
    """Return yaw and battery charge of a platform's vehicle. Both are None if the platform does not report them."""
    return platform.vitals if isinstance(platform, Examined) else Vitals()
