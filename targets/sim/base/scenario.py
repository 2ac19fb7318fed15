"""Scenario: `scenario.json` of a sim bundle, typed and checked, with the robots and their start poses."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, Literal

import msgspec

from koordgen.runtime.trace.schema import ApplicationRecord, BoxRecord, SharedVariable, WorldRecord
from koordgen.runtime.values.obstacles import Block, Cylinder, Mesh, Obstacle, Sphere
from koordgen.runtime.values.points import Point, distance, transmissible
from targets.sim.base.bodies import Vector
from targets.sim.base.folder import FOLDERS

AUTO, PYBULLET, MUJOCO = "auto", "pybullet", "mujoco"
PACKAGES = {PYBULLET: "pybullet", MUJOCO: "mujoco-core"}  # names on the package index


FILE = "scenario.json"
RESERVED = frozenset(FOLDERS)  # names that no squad has, because the folder of a run has a folder for each squad


class BadScenario(Exception):
    """A file that cannot be used. The message names the file and the fault, `hint` the way out."""

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.hint = hint


class GeodeticOrigin(msgspec.Struct, frozen=True):
    """WGS-84 position of the local frame's origin: degrees, and metres above mean sea level."""

    latitude: float
    longitude: float
    altitude: float


MOST_OBSTACLES = 1000  # as the fleet file allows


class Start(msgspec.Struct, frozen=True):
    """Start pose: metres, local ENU; yaw in radians counter-clockwise from east."""

    position: Vector
    yaw: float = 0.0


class Lidar(msgspec.Struct, frozen=True):
    """Lidar with `rays` spread evenly over the full turn, up to `range` (m), at `rate` turns a second.

    `noise` is the standard deviation (m) of ranges; None: that of positions."""

    rays: int = 180
    range: float = 6.0
    rate: float = 5.0
    noise: float | None = None


class Sim(msgspec.Struct, frozen=True):
    """Simulation settings of a robot.

    `load` fills in the harness's `fidelity` and noise where they are missing."""

    fidelity: Literal["full", "simple", ""] = ""
    lidar: Lidar = Lidar()
    autopilot: Literal["simulated", "external"] = "simulated"


class Robot(msgspec.Struct, frozen=True):
    """One robot.

    Bundle folder within the sim bundle, simulated body and device, settings of that body, start pose."""

    name: str
    pid: int
    target: str
    bundle: str
    body: str
    device: str
    start: Start
    settings: dict[str, Any] = {}
    inside: str = ""  # "module:function" that creates the platform in lockstep; empty: not available in lockstep
    sim: Sim = Sim()

    @property
    def external(self) -> bool:
        """True if a real autopilot flies the robot."""
        return self.sim.autopilot == "external"


class FleetDescription(msgspec.Struct, frozen=True):
    """One fleet of a scenario with squads.

    `name`: "" for the outer fleet, otherwise the name of the squad that the fleet is. `members`: the fleet's robots in
    the order of their pids; each is the place of a physical robot in `Scenario.robots`, or the name of a squad. Other
    fields: see Scenario."""

    name: str
    members: tuple[int | str, ...]
    app: str
    source: str
    program_hash: str
    delta: float
    geofence: BoxRecord
    drivers: tuple[tuple[str, str, str], ...] = ()
    shared: tuple[SharedVariable, ...] = ()
    records: dict[str, tuple[tuple[str, str], ...]] = {}
    applications: tuple[ApplicationRecord, ...] = ()
    application_id: int = 0


class Scenario(msgspec.Struct, frozen=True):
    """Scenario of a run.

    `harness`: the sim target's own settings, as its manifest declares them. `records`: the program's record types, each
    with its fields and their types in order.

    In a scenario with squads, `robots` has the physical robots of all fleets, and `pid` is their place in it. `fleets`
    describes the outer fleet first, then each squad. The scenario's own fields are those of the outer fleet."""

    app: str
    source: str
    program_hash: str
    delta: float
    origin: GeodeticOrigin
    geofence: BoxRecord
    robots: tuple[Robot, ...]
    obstacles: tuple[Obstacle, ...] = ()  # obstacles of the world, walls last; numbered from 0
    world: WorldRecord = WorldRecord()
    harness: dict[str, Any] = {}
    # (module of the program, Python module, class) of each driver that agents load.
    drivers: tuple[tuple[str, str, str], ...] = ()
    shared: tuple[SharedVariable, ...] = ()
    records: dict[str, tuple[tuple[str, str], ...]] = {}
    applications: tuple[ApplicationRecord, ...] = ()  # empty: the program is the only application
    application_id: int = 0
    fleets: tuple[FleetDescription, ...] = ()  # empty: one fleet without squads
    gui: bool = False  # True if the contact engine shows its window; set by --gui only

    @property
    def engine(self) -> str:
        """Requested contact engine; see targets/sim/physics/contacts.py."""
        return str(self.harness.get("engine", AUTO))

    def number(self, setting: str, default: float) -> float:
        """Return a numeric setting of the harness."""
        return float(self.harness.get(setting, default))


def load(root: Path, settings: Path | None = None) -> Scenario:
    """Load the scenario of the bundle at `root`; a JSON file may override its harness settings.

    Raises BadScenario."""
    path = root / FILE
    if not path.exists():
        raise BadScenario(
            f"{path}: not found, so the robots to simulate are unknown",
            "the bundle was built without a fleet: build it again with --fleet FILE",
        )
    try:
        scenario = msgspec.convert(_object(path), Scenario)
    except msgspec.ValidationError as error:
        raise BadScenario(f"{path}: {error}", "build the bundle again") from None
    _check(path, root, scenario)
    if settings is not None:
        scenario = msgspec.structs.replace(scenario, harness=_with_overrides(scenario.harness, settings))
    if scenario.engine not in (AUTO, *PACKAGES):
        raise BadScenario(f"engine is {scenario.engine!r}", f"there are: {', '.join((AUTO, *PACKAGES))}")
    return msgspec.structs.replace(scenario, robots=tuple(_filled(robot, scenario) for robot in scenario.robots))


def _filled(robot: Robot, scenario: Scenario) -> Robot:
    """Return the robot with the harness's settings where its own are missing. Raises BadScenario."""
    fidelity = robot.sim.fidelity or scenario.harness.get("fidelity", "full")
    if fidelity not in ("full", "simple"):
        raise BadScenario(f"fidelity is {fidelity!r}", "there are: full, simple")
    lidar = robot.sim.lidar
    if lidar.noise is None:
        lidar = msgspec.structs.replace(lidar, noise=scenario.number("position_noise", 0.0))
    return msgspec.structs.replace(robot, sim=msgspec.structs.replace(robot.sim, fidelity=fidelity, lidar=lidar))


def _object(path: Path) -> dict[str, Any]:
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise BadScenario(f"{path}: {getattr(error, 'strerror', None) or error}") from None
    if not isinstance(value, dict):
        raise BadScenario(f"{path}: a JSON object is expected")
    return value


def _check(path: Path, root: Path, scenario: Scenario) -> None:
    names = [robot.name for robot in scenario.robots]
    if not names or len(set(names)) != len(names):
        raise BadScenario(f"{path}: robots must have distinct names: {names}")
    if [robot.pid for robot in scenario.robots] != list(range(len(names))):
        raise BadScenario(f"{path}: the robots' pids must count from 0")
    if not (math.isfinite(scenario.delta) and scenario.delta > 0):
        raise BadScenario(f"{path}: delta must be a positive number of seconds, not {scenario.delta}")
    if len(scenario.obstacles) > MOST_OBSTACLES:
        raise BadScenario(f"{path}: {len(scenario.obstacles)} obstacles; there may be at most {MOST_OBSTACLES}")
    for number, obstacle in enumerate(scenario.obstacles):
        if not _solid(obstacle):
            raise BadScenario(f"{path}: obstacle {number} is not a valid solid: {obstacle}")
    for robot in scenario.robots:
        bundle = (root / robot.bundle).resolve()
        if not bundle.is_relative_to(root.resolve()) or not (bundle / "__main__.py").is_file():
            raise BadScenario(f"{path}: {robot.name}'s bundle {robot.bundle} is missing", "build the bundle again")
        if not all(map(math.isfinite, (*robot.start.position, robot.start.yaw))):
            raise BadScenario(f"{path}: {robot.name}'s start is not finite")
    _check_fleets(path, scenario)
    check_starts(scenario)


def _check_fleets(path: Path, scenario: Scenario) -> None:
    """Check that each physical robot is a member of one fleet, and that each squad has a description."""
    members = [member for fleet in scenario.fleets for member in fleet.members]
    physical = sorted(member for member in members if isinstance(member, int))
    if scenario.fleets and physical != list(range(len(scenario.robots))):
        raise BadScenario(f"{path}: each robot must be a member of one fleet", "build the bundle again")
    squads = [fleet.name for fleet in scenario.fleets]
    for name in RESERVED.intersection(squads):
        raise BadScenario(f"{path}: {name} is a folder of each run", "give the squad another name in the fleet file")
    for member in members:
        if isinstance(member, str) and member not in squads[1:]:
            raise BadScenario(f"{path}: the squad {member} is not described", "build the bundle again")


def check_starts(scenario: Scenario) -> None:
    """Refuse a fleet that cannot start: all inside the geofence, none in an obstacle, no two in one place.

    Raises BadScenario, before minutes are spent on a run."""
    hint = "give it another start in the fleet file"
    taken: dict[Vector, str] = {}
    for robot in scenario.robots:
        place = robot.start.position
        shown = f"({', '.join(f'{v:g}' for v in place)})"
        for name, box in (("arena", scenario.world.arena), ("geofence", scenario.geofence)):
            if box is not None and not _inside(box, place):
                raise BadScenario(f"{robot.name} starts at {shown}, outside the {name}", hint)
        for number, obstacle in enumerate(scenario.obstacles):
            if _within(obstacle, Point(*place)):
                raise BadScenario(f"{robot.name} starts at {shown}, inside obstacle {number}", hint)
        other = taken.setdefault(place, robot.name)
        if other != robot.name:
            raise BadScenario(f"{robot.name} starts at the same place as {other}, {shown}", hint)


def _solid(obstacle: Obstacle) -> bool:
    """Return whether an obstacle is valid: finite, with an extent, its faces among its vertices."""
    if not transmissible(obstacle):
        return False
    match obstacle:
        case Block(lo, hi):
            return lo.x < hi.x and lo.y < hi.y and lo.z < hi.z
        case Sphere(_, radius):
            return radius > 0
        case Cylinder(_, radius, height):
            return radius > 0 and height > 0
        case Mesh(vertices, faces):
            return bool(faces) and all(0 <= i < len(vertices) for face in faces for i in face)


def _within(obstacle: Obstacle, p: Point) -> bool:
    """Return whether a point is in a solid. A mesh is a surface: no point is in it."""
    match obstacle:
        case Block(lo, hi):
            return lo.x <= p.x <= hi.x and lo.y <= p.y <= hi.y and lo.z <= p.z <= hi.z
        case Sphere(centre, radius):
            return distance(centre, p) <= radius
        case Cylinder(base, radius, height):
            return math.hypot(p.x - base.x, p.y - base.y) <= radius and base.z <= p.z <= base.z + height
        case Mesh():
            return False


def _inside(box: BoxRecord, place: Vector) -> bool:
    """Return whether a point is in a box or on its faces. The box's corners may be given in any order."""
    return all(min(lo, hi) <= v <= max(lo, hi) for lo, v, hi in zip(box.lo, place, box.hi, strict=True))


def _with_overrides(harness: dict[str, Any], path: Path) -> dict[str, Any]:
    given = _object(path)
    for key, value in given.items():
        if key not in harness:
            raise BadScenario(f"{path}: no setting {key!r}", f"there are: {', '.join(sorted(harness))}")
        old = harness[key]
        number = isinstance(old, (int, float)) and not isinstance(old, bool)
        fits = type(value) in (int, float) and math.isfinite(value) if number else type(value) is type(old)
        if not fits:
            raise BadScenario(f"{path}: {key} is {value!r} where a value like {old!r} is expected")
    return {**harness, **given}
