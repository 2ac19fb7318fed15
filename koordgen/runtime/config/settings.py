"""Settings of a robot: types and reader of the file `settings.json` in the robot's bundle.

`koordgen build --fleet` writes this file."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from koordgen.runtime.values.obstacles import Obstacle
from koordgen.runtime.values.points import Point

Action = Literal["off", "log", "hold", "land", "stop"]  # reaction to a violated property; off: it is never evaluated

RELEASE = "RELEASE"  # file in a bundle that contains the id of the bundle's release


class BadSettings(Exception):
    """Raised for a settings file that cannot be used. The message names the file and the setting."""


# The ranges in this module equal the ranges in the fleet file; a test compares them. The settings are checked again on
# the robot, because an operator may have edited them there.
Port = Annotated[int, msgspec.Meta(ge=1, le=65535)]
Seconds = Annotated[float, msgspec.Meta(ge=0.05, le=10000.0)]


class PeerAddress(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Address at which a robot receives datagrams."""

    host: str
    port: Port


class Peer(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Robot of the fleet, and the address at which it receives datagrams. Its pid is its index in `peers`.

    `also`: further addresses, if the robot is a fleet: datagrams go to each of its robots."""

    name: str
    host: str
    port: Port
    also: tuple[PeerAddress, ...] = ()


class Origin(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Origin of the fleet's local ENU frame: WGS-84 degrees, and metres above mean sea level (AMSL)."""

    latitude: Annotated[float, msgspec.Meta(ge=-90, le=90)]
    longitude: Annotated[float, msgspec.Meta(ge=-180, le=180)]
    altitude: Annotated[float, msgspec.Meta(ge=-1000, le=10000)]


class Box(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Axis-aligned box between the corners `lo` and `hi`, in metres of the local ENU frame."""

    lo: Point
    hi: Point


class Safety(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Thresholds of the safety layer, in seconds or rounds."""

    position_stale: Seconds = 0.5  # seconds without a fresh own position after which the robot holds its position
    position_lost: Seconds = 2.0  # seconds without a fresh own position after which the robot stops safely

    # Number of consecutive rounds without current shared state after which `missed_action` applies.
    missed_rounds: Annotated[int, msgspec.Meta(ge=1, le=10000)] = 10
    missed_action: Literal["hold", "stop"] = "hold"  # hold: warn and keep holding; stop: stop safely

    # Number of rounds without messages of a robot after which the other robots continue without that robot.
    peer_timeout: Annotated[int, msgspec.Meta(ge=3, le=10000)] = 10
    outside_fence: Seconds = 0.5  # seconds outside the geofence after which the robot stops safely


class Network(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of the transport that carries datagrams between robots.

    `group`, `port` and `interface` are for multicast and broadcast. `mode`, `listen` and `connect` are for Zenoh, whose
    endpoints are texts such as `udp/192.168.1.20:47100`."""

    transport: Literal["unicast", "broadcast", "multicast", "zenoh"] = "unicast"
    group: str = ""  # IPv4 address on which all robots listen
    port: Port = 47000  # port of the group; it differs from the robots' own ports
    interface: str = ""  # address or name of the network interface; empty: the interface of the robot's own address
    mode: Literal["peer", "router", "client"] = "peer"  # Zenoh mode; a router forwards datagrams of other robots
    listen: tuple[str, ...] | None = None  # endpoints to listen on; None: the robot's own address, or none for a client
    connect: tuple[str, ...] | None = None  # endpoints to connect to; None: robots of lower pid (one link per pair)


class Settings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """All settings of one robot. The target checks the settings in `body`."""

    app: str
    robot: str
    pid: int
    delta: Annotated[float, msgspec.Meta(ge=0.005, le=60.0)]  # seconds in a round
    peers: tuple[Peer, ...]
    origin: Origin
    geofence: Box
    application_id: Annotated[int, msgspec.Meta(ge=0, le=65535)] = 0  # distinguishes fleets that share a network
    key_file: str | None = None  # file of the fleet's key (32 bytes, mode 0600), relative to the settings file
    insecure: bool = False  # True: the robot runs without a key and prints a warning
    safety: Safety = Safety()
    network: Network = Network()
    # Property -> reaction. A property is an invariant's name, "assume MODULE", "requires F", "ensures F", or "default".
    monitors: dict[str, Action] = {}
    body: dict[str, Any] = {}
    trace: str | None = None  # path of the trace; None: no trace is written

    # Largest size of all parts of the trace together, in megabytes (10^6 bytes); None: no limit.
    trace_limit: Annotated[float, msgspec.Meta(ge=1.0, le=1e6)] | None = 256.0
    # Seconds that a planner call within an event may take. Longer calls are counted and reported.
    planner_budget: Annotated[float, msgspec.Meta(ge=0.0005, le=1.0)] = 0.01
    obstacles: tuple[Obstacle, ...] = ()  # obstacles of the world, numbered from 0
    avoid: str = ""  # allread variable in which robots publish their paths; empty: planners ignore other robots
    bind: str = ""  # address to listen on; empty: the address to which the other robots send
    control: Port | None = None  # UDP port of control commands; None: the default of `control_port`
    release: Annotated[str, msgspec.Meta(pattern=r"\A([0-9a-f]{32})?\Z")] = ""  # release id from the file RELEASE
    state: str | None = "state"  # folder of persistent state, beside the bundle; None: nothing is persisted

    @property
    def control_port(self) -> int:
        """UDP port of control commands: `control`, or else the robot's port + 1000 (- 1000 above 65535)."""
        port = self.peers[self.pid].port
        return self.control or (port + 1000 if port + 1000 <= 65535 else port - 1000)


def load(path: Path, overrides: Path | None = None, pid: int | None = None) -> Settings:
    """Read the settings of a robot. Raises BadSettings.

    path: settings file of the bundle.
    overrides: file with further settings, or None. Its tables are merged; its other values replace those in `path`.
    pid: pid that replaces the pid in the files, or None."""
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
        raise BadSettings(f"{overrides or path}: a release is not set here but in the file {RELEASE}; remove `release`")
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
    """Return the content of a bundle's file RELEASE; "" if the bundle was built without a fleet file."""
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
        raise BadSettings(f"{path}: the file must contain a JSON object")
    return value


def _finite(text: str) -> float:
    """Convert a finite number. Raises ValueError for infinity and NaN: a NaN threshold is never exceeded."""
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
