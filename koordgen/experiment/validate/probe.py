"""Probes: simulation runs in which robots move from random starts to a target at a fixed offset.

For each run of a probe, a small Koord program and a fleet file are generated and built like a user's program. The run
is executed in lockstep, as in a campaign. The simulated world contains only the robots.

Frames: local ENU, metres. Each robot's path has its own frame, with the origin at the robot's nominal start. So the
target is at the offset, and the start is within `Start.radius` of the origin.
"""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from koordgen.build.bundle.drivers import find
from koordgen.build.bundle.write import write
from koordgen.build.pipeline import plan_file, read_fleet
from koordgen.experiment.campaign import drive, store
from koordgen.experiment.campaign.executor import Executor
from koordgen.experiment.campaign.plan import PROBES, CampaignPlan, PlannedRun
from koordgen.experiment.campaign.task import Job
from koordgen.fleet import manifest
from koordgen.fleet.file import own_classes
from koordgen.fleet.manifest import Target

Array = NDArray[np.float64]
Vector = tuple[float, float, float]
RATE = 240  # recorded poses of each robot per second: one pose for every step of the simulator
# A robot's velocity at the command of its target is the mean velocity from STATE seconds before to STATE seconds after
# the command.
STATE = 0.05
MOST_ROBOTS = 100  # largest number of robots in one run
KEPT = ("delta", "origin", "safety", "planner_budget", "mocap")  # keys copied from the user's fleet file
WEATHER = ("floor_friction", "wind")  # keys copied from the section `world` of the user's fleet file
PROGRAM = """\
# Probe: each robot moves towards a first target, and then gets a second one. Its path to the second one is observed.

param List<Point> first max 128 = []
param List<Point> shift max 128 = []  # vector from the robot to the second target
param List<int> last max 128 = []  # round in which the second target is given

using {module}:
  sensors: Point {position} as position
  actuators: Point {goal} at {position}

local: int now = 0

RunUp:
  pre: now == 0
  eff:
    now = 1
    if pid < len(first):
      {module}.{goal} = first[pid]

Wait:
  pre: 0 < now and pid < len(last) and now < last[pid]
  eff: now = now + 1

Go:
  pre: 0 < now and pid < len(last) and now == last[pid]
  eff:
    now = now + 1
    if pid < len(shift):
      {module}.{goal} = {module}.{position} + shift[pid]
"""


class BadProbe(Exception):
    """Raised if a probe is impossible, or if a run of the probe failed. `help` is advice for the user."""

    def __init__(self, message: str, help: str = "") -> None:
        super().__init__(message)
        self.help = help


@dataclass(frozen=True)
class Start:
    """Set of states from which the start of each probed robot is drawn at random.

    `radius`: largest distance of the robot from the nominal start when its target is commanded (m, uniform in x, y).
    `run_up`: distance in metres to a first target, which gives the robot a velocity; 0 for robots that stand.
    `turn`: largest angle between the direction of the first target and the direction of the offset, in rad.
    `after`: interval in seconds, from which the duration of the motion to the first target is drawn."""

    radius: float = 0.1
    turn: float = 0.1
    run_up: float = 4.0
    after: tuple[float, float] = (0.5, 2.5)


@dataclass(frozen=True)
class ProbedPlatform:
    """Platform to probe: all robots of a fleet file that have equal targets, settings and simulation settings.

    `robot`: entry of one of these robots in the fleet file.
    `common`: entries of the fleet file that apply to all robots.
    `beside`: path in bundles -> Python file with the user's own classes, such as drivers."""

    name: str
    target: str
    fidelity: str
    delta: float
    robot: Mapping[str, Any]
    common: Mapping[str, Any]
    beside: Mapping[str, Path]
    height: tuple[float, float]  # lowest and highest z of the geofence, in metres


@dataclass(frozen=True)
class Probe:
    """Request to observe robots of one platform while they move to a target.

    `offset`: position of the target relative to the nominal start (m, ENU).
    `count`: total number of robots to observe.
    `seconds`: time for which each robot is observed.
    `start`: set of states from which the robots' starts are drawn.
    `robots`: number of robots in each simulation run."""

    platform: ProbedPlatform
    offset: Vector
    count: int
    seconds: float
    start: Start = Start()
    robots: int = 16
    seed: int = 0

    @property
    def parts(self) -> int:
        """Return the number of simulation runs that are needed to observe `count` robots."""
        return math.ceil(self.count / self.robots)

    @property
    def flags(self) -> tuple[str, ...]:
        """Return the command-line options of each simulation run. The run lasts until the last robot is observed."""
        passed = math.ceil(self.start.after[1] / self.platform.delta) + 2
        duration = passed * self.platform.delta + self.seconds + STATE
        return (f"--duration={duration:g}", "--lockstep", "--no-report")


@dataclass(frozen=True, eq=False)
class Samples:
    """Paths of n robots that a probe observed at T times.

    `times` (T,): seconds since the target was commanded.
    `positions` (n, T, 3): metres. Each path has its own frame, with the origin at the robot's nominal start.
    `starts` (n, 7): each robot's position (m), velocity (m/s, ENU) and yaw (rad) at the command."""

    probe: Probe
    times: Array
    positions: Array
    starts: Array


def _harness() -> Target:
    return next(t for t in map(manifest.load, manifest.available()) if t.kind == "harness")


def platforms(fleet_file: str) -> dict[str, ProbedPlatform]:
    """Return the platforms of a fleet file by name. The name consists of target and fidelity: `quad full`.

    Robots with equal target and fidelity but different settings are different platforms. The names of such platforms
    also contain the name of their first robot. Raises Rejected, ManifestError."""
    targets = {name: manifest.load(name) for name in manifest.available()}
    harness = _harness()
    fleet, _ = read_fleet(fleet_file, targets, None)
    raw = yaml.safe_load(Path(fleet_file).read_text(encoding="utf-8"))
    common = {key: raw[key] for key in KEPT if key in raw}
    common["world"] = {key: value for key, value in (raw.get("world") or {}).items() if key in WEATHER}
    common[harness.name] = dict(raw.get(harness.name) or {})
    beside = {path: find(path, [Path(fleet_file).parent]) for path in own_classes(fleet, targets)}
    heights = fleet.geofence["lo"][2], fleet.geofence["hi"][2]
    kinds: dict[str, list[ProbedPlatform]] = {}
    seen: list[tuple[str, Any, Any]] = []
    for robot, entry in zip(fleet.robots, raw["robots"], strict=True):
        if (robot.target, robot.settings, robot.harness) in seen:
            continue
        seen.append((robot.target, robot.settings, robot.harness))
        own = {key: entry[key] for key in ("target", "settings", harness.name) if entry.get(key)}
        own["start"] = {"position": list(robot.start["position"])}
        fidelity = robot.harness.get(harness.name, {}).get("fidelity") or fleet.harness[harness.name]["fidelity"]
        found = ProbedPlatform(robot.name, robot.target, fidelity, fleet.delta, own, common, beside, heights)
        kinds.setdefault(f"{robot.target} {fidelity}", []).append(found)
    several = {f"{name} ({one.name})": one for name, kind in kinds.items() if len(kind) > 1 for one in kind}
    named = {name: kind[0] for name, kind in kinds.items() if len(kind) == 1} | several
    return {name: replace(platform, name=name) for name, platform in named.items()}


def check(probe: Probe) -> None:
    """Check that a probe can be executed. Raises BadProbe if it cannot."""
    platform = probe.platform
    target = manifest.load(platform.target)
    program_of(target)
    if platform.robot.get(_harness().name, {}).get("autopilot") == "external":
        raise BadProbe(
            f"{platform.name} has an external autopilot, which runs in real time only",
            "set `autopilot: simulated` for its robots in the fleet file",
        )
    if not 1 <= probe.robots <= MOST_ROBOTS:
        raise BadProbe(f"{probe.robots} robots in one run, but 1 to {MOST_ROBOTS} are allowed")
    if not any(probe.offset[:2]):
        raise BadProbe(f"the offset {_shown(probe.offset)} is zero in x and y", "give an offset with another x or y")


def fleet_of(probe: Probe, part: int) -> dict[str, Any]:
    """Return the content of the fleet file for one run of a probe.

    `part`: number of the run. The random starts depend only on the seed, on `part` and on the robot's number."""
    platform, start = probe.platform, probe.start
    apart = 2 * (math.hypot(*probe.offset[:2]) + start.run_up) + 6.0
    columns = math.ceil(math.sqrt(probe.robots))
    ahead = math.atan2(probe.offset[1], probe.offset[0])
    robots, first, shift, last = [], [], [], []
    for k in range(min(probe.robots, probe.count - part * probe.robots)):
        random = Random(f"{probe.seed}/{part}/{k}/probe")
        x, y = apart * (k % columns), apart * (k // columns)
        z = platform.robot["start"]["position"][2]
        yaw = ahead + random.uniform(-start.turn, start.turn)
        away, around = start.radius * math.sqrt(random.random()), random.uniform(0, math.tau)
        after = random.uniform(*start.after)
        first.append([x + start.run_up * math.cos(yaw), y + start.run_up * math.sin(yaw), z])
        dx, dy, dz = probe.offset
        shift.append([dx - away * math.cos(around), dy - away * math.sin(around), dz])
        last.append(max(1, round(after / platform.delta)))
        placed = {"position": [x, y, z], "yaw": math.remainder(yaw, math.tau)}
        robots.append({**platform.robot, "name": f"r{k}", "address": f"127.0.0.1:{47100 + k}", "start": placed})
    low, high = -apart, apart * columns
    harness = _harness().name
    quiet = {"min_separation": 0.0, "start_noise": 0.0, "idle_timeout": 0.0, "pose_rate": float(RATE)}
    return {
        **platform.common,
        harness: {**platform.common[harness], **quiet},
        "geofence": {"lo": [low, low, platform.height[0]], "hi": [high, high, platform.height[1]]},
        "params": {"first": first, "shift": shift, "last": last},
        "robots": robots,
    }


def program_of(target: manifest.Target) -> str:
    """Return the Koord program that moves robots of a target in a probe.

    Raises BadProbe if the target has no port that commands a position."""
    if target.goal is None:
        raise BadProbe(f"target {target.name} has no port that commands a robot to a position")
    module, position, goal = target.goal
    return PROGRAM.format(module=module, position=position, goal=goal)


def build_probe(probe: Probe, part: int, folder: Path) -> None:
    """Generate the program and the fleet file for one run of a probe, and build a simulation bundle of them.

    All files are written into the new folder `folder`. Raises Rejected, CannotWrite, OSError."""
    folder.mkdir(parents=True)
    program, fleet = folder / "probe.koord", folder / "fleet.yaml"
    program.write_text(program_of(manifest.load(probe.platform.target)), encoding="utf-8")
    fleet.write_text(yaml.safe_dump(fleet_of(probe, part), sort_keys=False), encoding="utf-8")
    for path, file in probe.platform.beside.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(file, folder / path)
    harness = _harness().name
    _, bundles = plan_file(str(program), [harness], str(fleet), {})
    write({harness: bundles[harness]}, folder)


def collect_samples(
    probes: Sequence[Probe],
    executor: Executor,
    folder: Path,
    report_progress: Callable[[str], None] = lambda _: None,
    interrupted: Callable[[], bool] = lambda: False,
) -> list[Samples]:
    """Execute the simulation runs of all probes in a new folder, and return the observed paths of each probe.

    A run writes about 10 MB of files. They are deleted when the run's paths have been read. Raises BadProbe if a probe
    is impossible or a run failed. Exceptions of `drive.execute_runs` are passed on."""
    for probe in probes:
        check(probe)
    runs: list[PlannedRun] = []
    owner: dict[int, tuple[Probe, int]] = {}
    for index, probe in enumerate(probes):
        for part in range(probe.parts):
            described = {
                "platform": probe.platform.name,
                "offset": _shown(probe.offset),
                "seed": str(probe.seed + part),
            }
            owner[len(runs)] = probe, part
            runs.append(
                PlannedRun(len(runs), described, {"probe": f"{index}/{part}"}, {}, {"seed": str(probe.seed + part)})
            )

    def build(params: Mapping[str, str], own: Path) -> None:
        index, _, part = params["probe"].partition("/")
        build_probe(probes[int(index)], int(part), own)

    def job(run: PlannedRun) -> Job:
        return Job(run.number, run.varied, (*owner[run.number][0].flags, f"--seed={run.flags['seed']}"), {}, "", True)

    varied = tuple(sorted({described for run in runs for described in run.varied.values()}))
    plan = CampaignPlan("probe", "", "", (), varied, len(runs), PROBES)
    with store.claimed(folder, plan, resume=False) as kept:
        bundles = drive.Bundles(folder / "bundles", _harness().name, build, runs)
        drive.execute_runs(runs, kept, executor, bundles, job, report_progress, interrupted)
        for result in kept.results.values():
            if result.outcome == "failed":
                raise BadProbe(f"run {runs[result.run].name} of a probe failed: {result.why}")
        return [_gathered(probe, [r for r in runs if owner[r.number][0] is probe], kept) for probe in probes]


def _shown(offset: Vector) -> str:
    return f"({', '.join(f'{v:g}' for v in offset)})"


def _gathered(probe: Probe, runs: Sequence[PlannedRun], kept: store.CampaignStore) -> Samples:
    times = np.arange(round(probe.seconds * RATE) + 1) / RATE
    found: list[tuple[Array, Array]] = []
    for run in runs:
        found += _seen(kept.run_folder(run.name) / "trace.jsonl", probe, times)
        shutil.rmtree(kept.run_folder(run.name), ignore_errors=True)
    return Samples(probe, times, np.array([p for p, _ in found]), np.array([s for _, s in found]))


def _seen(trace: Path, probe: Probe, times: Array) -> list[tuple[Array, Array]]:
    """Return the path and the start of each robot, read from the trace of one run. Raises BadProbe, OSError."""
    poses: dict[int, list[tuple[float, ...]]] = {}
    gone: dict[int, tuple[float, Sequence[float]]] = {}
    with trace.open("rb") as file:
        for line in file:
            record = json.loads(line)
            match record:
                case {"kind": "pose", "t": t, "pid": pid, "position": [x, y, z], "yaw": yaw}:
                    poses.setdefault(pid, []).append((t, x, y, z, yaw))
                case {"kind": "round", "event": "Go", "t": t, "pid": pid, "actuators": written} if written:
                    gone[pid] = t, next(iter(written.values()))  # the generated program writes only one actuator
    if missing := set(poses) - set(gone):
        why = f"{trace}: robot {min(missing)} was never sent to its second target"
        raise BadProbe(why, "make a report of the run's folder with `koordgen report`")
    return [_sample(np.array(poses[pid]), *gone[pid], probe.offset, times) for pid in sorted(poses)]


def _sample(poses: Array, at: float, target: Sequence[float], offset: Vector, times: Array) -> tuple[Array, Array]:
    t, yaw = poses[:, 0], np.unwrap(poses[:, 4])
    if t[-1] < at + times[-1]:
        raise BadProbe(f"a run of a probe ended {at + times[-1] - t[-1]:.2f} s before the end of the observation")
    origin = np.array(target) - np.array(offset)

    def place(when: Array) -> Array:
        found: Array = np.stack([np.interp(when, t, poses[:, axis]) for axis in (1, 2, 3)], axis=-1) - origin
        return found

    way = place(at + times)
    velocity = (place(np.array([at + STATE])) - place(np.array([at - STATE])))[0] / (2 * STATE)
    return way, np.array([*way[0], *velocity, float(np.interp(at, t, yaw))])
