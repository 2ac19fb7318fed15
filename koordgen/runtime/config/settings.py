"""Settings of a robot.

`settings.json` of its bundle, written by `koordgen build --fleet`, read and typed here."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from koordgen.runtime.values.obstacles import Obstacle
from koordgen.runtime.values.points import Point

Action = Literal["off", "log", "hold", "land", "stop"]  # reaction to a violated property; off: it is not evaluated

RELEASE = "RELEASE"  # file of a bundle that names the release it was built in


class BadSettings(Exception):
    """A settings file that cannot be used; the message names the file and the key."""


# The ranges are those of the fleet file (a test compares them). They are checked here as well, because an operator may
# edit the settings on the robot.
Port = Annotated[int, msgspec.Meta(ge=1, le=65535)]
Seconds = Annotated[float, msgspec.Meta(ge=0.05, le=10000.0)]


class Peer(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Address at which one robot receives its datagrams. Its index in `peers` is its pid."""

    name: str
    host: str
    port: Port


class Origin(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """WGS-84 position of the fleet's local ENU frame: degrees, and metres above mean sea level (AMSL)."""

    latitude: Annotated[float, msgspec.Meta(ge=-90, le=90)]
    longitude: Annotated[float, msgspec.Meta(ge=-180, le=180)]
    altitude: Annotated[float, msgspec.Meta(ge=-1000, le=10000)]


class Box(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Axis-aligned box: metres, local ENU."""

    lo: Point
    hi: Point


class Safety(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Thresholds of the safety layer, in seconds or rounds."""

    position_stale: Seconds = 0.5  # seconds without a fresh own position, then hold
    position_lost: Seconds = 2.0  # seconds without a fresh own position, then stop safely
    # consecutive rounds without current shared state, then `missed_action`
    missed_rounds: Annotated[int, msgspec.Meta(ge=1, le=10000)] = 10
    missed_action: Literal["hold", "rest"] = "hold"  # keep holding with a warning, or stop safely
    # rounds without messages of a robot, then the others continue without it
    peer_timeout: Annotated[int, msgspec.Meta(ge=3, le=10000)] = 10
    outside_fence: Seconds = 0.5  # seconds outside the geofence, then stop safely


class Network(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Transport of datagrams between robots.

    `group` to `interface` are for multicast and broadcast, the rest for Zenoh, with endpoints such as
    `udp/192.168.1.20:47100`."""

    transport: Literal["unicast", "broadcast", "multicast", "zenoh"] = "unicast"
    group: str = ""  # IPv4 address that all robots listen on
    port: Port = 47000  # port of the group; differs from the robots' own ports
    interface: str = ""  # address or name of the multicast interface; empty: that of the robot's own address
    mode: Literal["peer", "router", "client"] = "peer"  # routers forward datagrams of others
    listen: tuple[str, ...] | None = None  # endpoints; None: the robot's own address, or none for a client
    connect: tuple[str, ...] | None = None  # endpoints; None: the robots of lower pid, so each pair connects once


class Settings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """All settings of one robot. `body` belongs to the target, which checks it."""

    app: str
    robot: str
    pid: int
    delta: Annotated[float, msgspec.Meta(ge=0.005, le=60.0)]  # seconds in a round
    peers: tuple[Peer, ...]
    origin: Origin
    geofence: Box
    application_id: Annotated[int, msgspec.Meta(ge=0, le=65535)] = 0  # distinguishes fleets that share a network
    key_file: str | None = None  # 32 bytes, mode 0600; relative to the settings file
    insecure: bool = False  # run without a key, with a warning
    safety: Safety = Safety()
    network: Network = Network()
    monitors: dict[str, Action] = {}  # by an invariant's name, "assume MODULE", "requires F", "ensures F", or "default"
    body: dict[str, Any] = {}
    trace: str | None = None  # JSON lines, one a round
    # megabytes (10^6 bytes) of all parts of the trace together; None: no limit
    trace_limit: Annotated[float, msgspec.Meta(ge=1.0, le=1e6)] | None = 256.0
    # seconds that a planner call within an event may take; longer calls are counted and reported
    planner_budget: Annotated[float, msgspec.Meta(ge=0.0005, le=1.0)] = 0.01
    obstacles: tuple[Obstacle, ...] = ()  # obstacles of the world, numbered from 0
    avoid: str = ""  # allread variable in which robots publish their paths; empty: planners ignore other robots
    bind: str = ""  # address to listen on, if it differs from the one that peers send to
    control: Port | None = None  # UDP port of control commands; None: `control_port`
    release: Annotated[str, msgspec.Meta(pattern=r"\A([0-9a-f]{32})?\Z")] = ""  # from the bundle's file RELEASE
    state: str | None = "state"  # folder of persistent state, beside the bundle; None: nothing is persisted

    @property
    def control_port(self) -> int:
        """UDP port of control commands: the robot's port plus 1000 (minus 1000 beyond 65535), unless set."""
        port = self.peers[self.pid].port
        return self.control or (port + 1000 if port + 1000 <= 65535 else port - 1000)


def load(path: Path, overrides: Path | None = None, pid: int | None = None) -> Settings:
    """Read a settings file. Another file (tables merge, other values replace) and a pid may override it.

    Raises BadSettings."""
    merged = _read(path)
    base = path.parent
    if overrides is not None:
        over = _read(overrides)
        if "key_file" in over:
            base = overrides.parent
        merged = _merge(merged, over)
    if pid is not None:
        merged["pid"] = pid
    if merged.get("release"):
        raise BadSettings(f"{overrides or path}: a release is not set, it is read from the bundle's file {RELEASE}")
    merged["release"] = _release(path.parent / RELEASE)
    try:
        settings = msgspec.convert(merged, Settings)
    except msgspec.ValidationError as error:
        raise BadSettings(f"{overrides or path}: {error}") from None
    if not 0 <= settings.pid < len(settings.peers):
        raise BadSettings(f"{overrides or path}: pid {settings.pid} is not among the {len(settings.peers)} peers")
    if settings.key_file is not None:
        settings = msgspec.structs.replace(settings, key_file=str(base / settings.key_file))
    return settings


def _release(path: Path) -> str:
    """Return the content of a bundle's file RELEASE; "" if it was built without a fleet file."""
    try:
        return path.read_text(encoding="ascii").strip()
    except FileNotFoundError:
        return ""
    except (OSError, UnicodeError) as error:
        raise BadSettings(f"{path}: {error}; copy the bundle again") from None


def _read(path: Path) -> dict[str, Any]:
    try:
        value = json.loads(path.read_text(encoding="utf-8"), parse_float=_finite, parse_constant=_finite)
    except OSError as error:
        raise BadSettings(f"{path}: {error.strerror or error}") from None
    except ValueError as error:
        raise BadSettings(f"{path}: not JSON: {error}") from None
    if not isinstance(value, dict):
        raise BadSettings(f"{path}: a JSON object is expected")
    return value


def _finite(text: str) -> float:
    """Refuse NaN and infinity: a NaN threshold is never passed, and such a fence never holds."""
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text} is not a finite number")
    return value


def _merge(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    merged = dict(below)
    for key, value in above.items():
        old = merged.get(key)
        merged[key] = _merge(old, value) if isinstance(old, dict) and isinstance(value, dict) else value
    return merged
