"""Platform interface, which a target implements: one robot's vehicle behind its program's ports.

The agent is one poll loop. It calls `poll` at least every `period` seconds and everything else between two polls. No
call may block for more than a few milliseconds (longer work runs in a process of the platform's own), none sleeps, and
time is passed as an argument, so that a simulator can control it. Frames: local ENU metres about the fleet's origin,
yaw in radians counter-clockwise from east."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Protocol, runtime_checkable

if TYPE_CHECKING:  # this module must be importable without any package, for checks
    from koordgen.runtime.values.points import Point


class Unready(Exception):
    """The vehicle cannot serve: a link, a device or a setting is wrong. `hint` says how to fix it."""

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint


State = Literal["ok", "warn", "fail"]


@dataclass(frozen=True, slots=True)
class Finding:
    """Result of one check before a mission: the state found, in a few words with units.

    If it is not right: `wanted` is the right state (empty if obvious), and `why` the consequence and the fix."""

    name: str
    state: State
    found: str
    wanted: str = ""
    why: str = ""

    @staticmethod
    def of(name: str, error: Unready) -> Finding:
        """Return the failed check for an error that ended further checks."""
        return Finding(name, "fail", error.message, why=error.hint)


@dataclass(frozen=True, slots=True)
class Sensed:
    """Values of the sensor ports at one time.

    `values` is keyed by "Module.port". `time`: when the position was true (seconds on the agent's clock), or None
    before the first position."""

    values: Mapping[str, Any]
    time: float | None


@dataclass(frozen=True, slots=True)
class Vitals:
    """State of a vehicle for operators.

    Yaw (radians, counter-clockwise from east) and battery charge (0 to 1).

    None: unknown."""

    yaw: float | None = None
    battery: float | None = None


class Platform(Protocol):
    """Platform of one robot.

    Life cycle: `diagnose` or (`start`, `poll` until `ready`, rounds, `rest`, `poll` until `rested`), then `close`."""

    period: float  # seconds between two polls of the control loop

    def diagnose(self) -> list[Finding]:
        """Open all links and devices, check them, and close them, without motion.

        The first failure is the one to fix first; checks that depend on it may be left out. Raises nothing for a failed
        check. May take up to 15 seconds, the only call that may."""
        ...

    def start(self, now: float) -> None:
        """Open the links and begin to become ready (a quad takes off). Raises Unready."""
        ...

    def poll(self, now: float) -> None:
        """Read the links, run the controller, write commands. Raises Unready if the vehicle is lost for good."""
        ...

    @property
    def ready(self) -> bool:
        """True if the robot is where a mission can begin, with fresh sensors."""
        ...

    @property
    def progress(self) -> str:
        """The vehicle's present activity in a few words for the log.

        "waiting for a heartbeat on udp:...", "climbing"."""
        ...

    @property
    def stall(self) -> str:
        """Why the vehicle has no path to its last command: the target, then the obstacle.

        "" while it has a path, needs none, holds, or stops."""
        ...

    def sense(self, now: float) -> Sensed:
        """Return the values of all sensor ports that the target offers."""
        ...

    def command(self, actuators: Mapping[str, Any], now: float) -> None:
        """Execute an event's writes to actuators ("Module.port" to value).

        They are finite and inside the geofence."""
        ...

    def call(self, port: str, args: tuple[Any, ...]) -> Any:
        """Answer a callable port ("Motion.planner") within the calling event.

        A planner's answer is a tuple of Points, empty if there is no path. An exception discards the event."""
        ...

    def others(self, paths: Mapping[int, tuple[Point, ...]]) -> None:
        """Store the other robots' published paths by pid, for calls of the next event.

        Each path begins where that robot is or was. A single point: it stays there. No path: it has published none."""
        ...

    def news(self) -> list[str]:
        """Return log lines on problems since the last call that do not end the mission."""
        ...

    def hold(self, on: bool, now: float) -> None:
        """Hold at the present position, or resume the last command. Idempotent.

        A vehicle at rest does not start: a quad that is held before take-off stays on the ground. Called from before
        `start` on."""
        ...

    def rest(self, now: float) -> None:
        """Begin the safe stop: land, or brake and go neutral. Idempotent; cannot be undone."""
        ...

    @property
    def rested(self) -> bool:
        """True once the safe stop is complete."""
        ...

    def close(self) -> None:
        """Close links and devices; the vehicle is at rest or in its own failsafe. Idempotent."""
        ...


@runtime_checkable
class Resumes(Protocol):
    """Platform that can resume within a path. Others receive the whole command again after a restart."""

    def resume(self, actuators: Mapping[str, Any], now: float) -> None:
        """Resume the commands of an earlier life of this robot, as `command` does.

        The points of a path before the leg that is nearest to the robot count as passed. No planner has checked the way
        to the next point."""
        ...


@runtime_checkable
class Examined(Protocol):
    """Platform that reports vitals."""

    @property
    def vitals(self) -> Vitals: ...


def vitals(platform: Platform) -> Vitals:
    """Return a platform's vitals; all unknown if it does not report them."""
    return platform.vitals if isinstance(platform, Examined) else Vitals()
