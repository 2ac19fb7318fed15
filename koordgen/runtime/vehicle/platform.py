"""What a target implements: one robot's body behind its program's ports.

The agent is one poll loop. It calls `poll` at least every `period` seconds and everything else between two polls;
no call may block for more than a few milliseconds (what takes longer runs in a process of the platform's own), none
sleeps, and time comes in as an argument, so that the simulator can own it. Frames: local ENU metres about the
fleet's origin, yaw in radians counter-clockwise from east.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Protocol, runtime_checkable

if TYPE_CHECKING:  # what is found must be told even where no package is installed
    from koordgen.runtime.values.points import Point


class Unready(Exception):
    """The body cannot serve: a link, a device or a setting is wrong. `hint` says what to do about it."""

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint


State = Literal["ok", "warn", "fail"]


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing looked at before a mission: what it is like, in a few words with units. Where it is not right, `wanted`
    says how it should be (empty where that is plain) and `why` what comes of it otherwise and what to do."""

    name: str
    state: State
    found: str
    wanted: str = ""
    why: str = ""

    @staticmethod
    def of(name: str, error: Unready) -> Finding:
        """What kept us from looking on."""
        return Finding(name, "fail", error.message, why=error.hint)


@dataclass(frozen=True, slots=True)
class Sensed:
    """The sensor ports at one moment. `values` is keyed by "Module.port"; `time` is when the position in it was true
    (seconds on the agent's clock), or None when there has been none yet."""

    values: Mapping[str, Any]
    time: float | None


@dataclass(frozen=True, slots=True)
class Vitals:
    """State of a body that no program needs, but people do: yaw in radians counter-clockwise from east, and the charge
    of its battery, 0 to 1. None: not known."""

    yaw: float | None = None
    battery: float | None = None


class Platform(Protocol):
    """Life: `diagnose` or (`start`, then `poll` until `ready`, rounds, `rest`, `poll` until `rested`), then `close`."""

    period: float  # seconds between two polls of the control loop

    def diagnose(self) -> list[Finding]:
        """Open what must be opened, look, and close it, moving nothing. The first that fails is the one to repair
        first; what cannot be looked at because of it may be left out. Raises nothing for what is merely wrong.
        May take up to 15 seconds, the only call that may."""
        ...

    def start(self, now: float) -> None:
        """Open the links and begin to become ready (a quad takes off). Raises Unready."""
        ...

    def poll(self, now: float) -> None:
        """Read the links, run the controller, write commands. Raises Unready when the body is lost for good."""
        ...

    @property
    def ready(self) -> bool:
        """Whether the robot is where a mission can begin, with fresh sensors."""
        ...

    @property
    def progress(self) -> str:
        """What the body is doing now, in a few words for the log: "waiting for a heartbeat on udp:...", "climbing"."""
        ...

    @property
    def stall(self) -> str:
        """Why the body has no way to what was commanded last: what is wanted, then what is in the way. "" while it has
        a way, needs none, or was told to hold or to come to rest."""
        ...

    def sense(self, now: float) -> Sensed:
        """Sample all sensor ports the target offers."""
        ...

    def command(self, actuators: Mapping[str, Any], now: float) -> None:
        """Take the actuators that an event wrote ("Module.port" to value), already finite and inside the geofence."""
        ...

    def call(self, port: str, args: tuple[Any, ...]) -> Any:
        """Answer a callable port ("Motion.planner"), within the event that asks: a planner's answer is a tuple of
        Points, empty when there is no way. May raise; then the event is discarded."""
        ...

    def others(self, paths: Mapping[int, tuple[Point, ...]]) -> None:
        """The other robots' published paths by pid, each from where that robot is or was (a single point: it stays
        there; none: it has published nothing). They come before an event whose calls are to keep clear of them."""
        ...

    def news(self) -> list[str]:
        """What went wrong since this was asked last and does not end the mission, a line each for the log."""
        ...

    def hold(self, on: bool, now: float) -> None:
        """Pause at the present position, or resume what was commanded last. Idempotent. What does not move
        yet does not begin to: a quad that is held before it took off stays on the ground for as long. Called from
        before `start` on."""
        ...

    def rest(self, now: float) -> None:
        """Begin the safe end: land, or brake and go neutral. Idempotent; not undone."""
        ...

    @property
    def rested(self) -> bool:
        """Whether the safe end is reached."""
        ...

    def close(self) -> None:
        """Give back links and devices; the body has been left at rest or in its own failsafe. Idempotent."""
        ...


@runtime_checkable
class Resumes(Protocol):
    """A platform that can go on amid a path. One that cannot is commanded anew after a restart."""

    def resume(self, actuators: Mapping[str, Any], now: float) -> None:
        """As `command`, with what an earlier life of this robot had commanded: of a path, the points before the leg
        that is nearest to the robot are behind it. The way to the next point has not been checked by anybody."""
        ...


@runtime_checkable
class Examined(Protocol):
    """A platform that knows its vitals."""

    @property
    def vitals(self) -> Vitals: ...


def vitals(platform: Platform) -> Vitals:
    """Return a platform's vitals; nothing is known of a platform that does not tell them."""
    return platform.vitals if isinstance(platform, Examined) else Vitals()
