"""Probes: runs in which robots of one platform go from random starts to a target at a fixed offset.

For a probe, a small Koord program and a fleet file are generated, built by the ordinary pipeline, and run in lockstep
like the runs of a campaign. The world of a probe contains nothing but the robots.

Frames: local ENU, metres. Each sample has its own frame, with the origin at the nominal start. So the target is at the
offset, and the start is within `Start.radius` of the origin.
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
RATE = 240  # recorded poses per second: one for every step of the simulated world
# The velocity at the start is the average from this many seconds before the start until as many seconds after it.
STATE = 0.05
MOST_ROBOTS = 100  # largest number of robots in one run
KEPT = ("delta", "origin", "safety", "planner_budget", "mocap")  # keys that are copied from the user's fleet file
WEATHER = ("floor_friction", "wind")  # keys that are copied from the `world` of the user's fleet file
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
    """Raised if a probe is impossible or could not be executed. `help` names a remedy."""

    def __init__(self, message: str, help: str = "") -> None:
        super().__init__(message)
        self.help = help


@dataclass(frozen=True)
class Start:
    """Set of starts, from which each sample draws its start.

    `radius`: when the target is commanded, the robot is within this distance of the nominal start (m, uniform in x and
        y).
    `run_up`: distance in metres of a first target, to which the robot moves before; 0 if the robot stands at the start.
    `turn`: largest angle between the directions of the first target and of the offset, in rad.
    `after`: interval in seconds from which the duration of the movement to the first target is drawn."""

    radius: float = 0.1
    turn: float = 0.1
    run_up: float = 4.0
    after: tuple[float, float] = (0.5, 2.5)


@dataclass(frozen=True)
class ProbedPlatform:
    """Platform to probe: robots of a fleet file with the same target, settings and simulation.

    `robot`: the entry of one such robot in the fleet file.
    `common`: the file's entries for all robots.
    `beside`: path in bundles -> file of the user's own classes."""

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
    """Request for samples of one platform's motion.

    `offset`: the target relative to the nominal start (m, ENU).
    `seconds`: duration of the observation of each robot.
    `count`: number of robots that are observed in all runs together.
    `robots`: number of robots in each run."""

    platform: ProbedPlatform
    offset: Vector
    count: int
    seconds: float
    start: Start = Start()
    robots: int = 16
    seed: int = 0

    @property
    def parts(self) -> int:
        """Return the number of runs of the probe."""
        return math.ceil(self.count / self.robots)

    @property
    def flags(self) -> tuple[str, ...]:
        """Return the command-line options of each run."""
        passed = math.ceil(self.start.after[1] / self.platform.delta) + 2
        duration = passed * self.platform.delta + self.seconds + STATE
        return (f"--duration={duration:g}", "--lockstep", "--no-report")


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples of a probe: n robots, observed at T times.

    `times` (T,): seconds since the target was commanded.
    `positions` (n, T, 3): metres, each in its sample's own frame.
    `starts` (n, 7): position (m), velocity (m/s, ENU) and yaw (rad)."""

    probe: Probe
    times: Array
    positions: Array
    starts: Array


def _harness() -> Target:
    return next(t for t in map(manifest.load, manifest.available()) if t.kind == "harness")


def platforms(fleet_file: str) -> dict[str, ProbedPlatform]:
    """Return the platforms of a fleet file by name. A name consists of target and fidelity.

    Robots with the same target and fidelity but different settings are different platforms, whose names include the
    name of the first such robot. Raises Rejected, ManifestError."""
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
    """Check that a probe is possible. Raises BadProbe."""
    platform = probe.platform
    target = manifest.load(platform.target)
    program_of(target)
    if platform.robot.get(_harness().name, {}).get("autopilot") == "external":
        raise BadProbe(f"{platform.name} is flown by an external autopilot, which runs in real time only")
    if not 1 <= probe.robots <= MOST_ROBOTS:
        raise BadProbe(f"{probe.robots} robots in a run; 1 to {MOST_ROBOTS} are allowed")
    if not any(probe.offset[:2]):
        raise BadProbe(f"the offset {_told(probe.offset)} is zero in x and y", "give another")


def fleet_of(probe: Probe, part: int) -> dict[str, Any]:
    """Return the content of the fleet file of one run.

    All random values are determined by the seed, the number of the run, and the robot."""
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
    """Return the program that probes robots of a target. Raises BadProbe."""
    if target.goal is None:
        raise BadProbe(f"target {target.name} has no port that sends a robot to a position")
    module, position, goal = target.goal
    return PROGRAM.format(module=module, position=position, goal=goal)


def build_probe(probe: Probe, part: int, folder: Path) -> None:
    """Write the program and the fleet file of a run, and build their bundle into `folder`.

    Raises Rejected, CannotWrite, OSError."""
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


def take_samples(
    probes: Sequence[Probe],
    executor: Executor,
    folder: Path,
    tell: Callable[[str], None] = lambda _: None,
    interrupted: Callable[[], bool] = lambda: False,
) -> list[Samples]:
    """Execute all runs of a probe in a new folder, as a campaign does, and return the samples.

    A run writes some 10 MB of files, which are deleted once its samples are read. Raises BadProbe if a probe is
    impossible or could not be executed, and what `drive.execute_runs` raises."""
    for probe in probes:
        check(probe)
    runs: list[PlannedRun] = []
    owner: dict[int, tuple[Probe, int]] = {}
    for index, probe in enumerate(probes):
        for part in range(probe.parts):
            told = {"platform": probe.platform.name, "offset": _told(probe.offset), "seed": str(probe.seed + part)}
            owner[len(runs)] = probe, part
            runs.append(PlannedRun(len(runs), told, {"probe": f"{index}/{part}"}, {}, {"seed": str(probe.seed + part)}))

    def build(params: Mapping[str, str], own: Path) -> None:
        index, _, part = params["probe"].partition("/")
        build_probe(probes[int(index)], int(part), own)

    def job(run: PlannedRun) -> Job:
        return Job(run.number, run.varied, (*owner[run.number][0].flags, f"--seed={run.flags['seed']}"), {}, "", True)

    varied = tuple(sorted({told for run in runs for told in run.varied.values()}))
    plan = CampaignPlan("probe", "", "", (), varied, len(runs), PROBES)
    with store.claimed(folder, plan, resume=False) as kept:
        bundles = drive.Bundles(folder / "bundles", _harness().name, build, runs)
        drive.execute_runs(runs, kept, executor, bundles, job, tell, interrupted)
        for result in kept.results.values():
            if result.outcome == "failed":
                raise BadProbe(f"run {runs[result.run].name} of a probe did not run: {result.why}")
        return [_gathered(probe, [r for r in runs if owner[r.number][0] is probe], kept) for probe in probes]


def _told(offset: Vector) -> str:
    return f"({', '.join(f'{v:g}' for v in offset)})"


def _gathered(probe: Probe, runs: Sequence[PlannedRun], kept: store.CampaignStore) -> Samples:
    times = np.arange(round(probe.seconds * RATE) + 1) / RATE
    found: list[tuple[Array, Array]] = []
    for run in runs:
        found += _seen(kept.run_folder(run.name) / "trace.jsonl", probe, times)
        shutil.rmtree(kept.run_folder(run.name), ignore_errors=True)
    return Samples(probe, times, np.array([p for p, _ in found]), np.array([s for _, s in found]))


def _seen(trace: Path, probe: Probe, times: Array) -> list[tuple[Array, Array]]:
    """Return the path and the start of each robot in one run. Raises BadProbe, OSError."""
    poses: dict[int, list[tuple[float, ...]]] = {}
    gone: dict[int, tuple[float, Sequence[float]]] = {}
    with trace.open("rb") as file:
        for line in file:
            record = json.loads(line)
            match record:
                case {"kind": "pose", "t": t, "pid": pid, "position": [x, y, z], "yaw": yaw}:
                    poses.setdefault(pid, []).append((t, x, y, z, yaw))
                case {"kind": "round", "event": "Go", "t": t, "pid": pid, "actuators": written} if written:
                    gone[pid] = t, next(iter(written.values()))  # the generated program has only one actuator
    if missing := set(poses) - set(gone):
        why = f"{trace}: robot {min(missing)} never came to its second target"
        raise BadProbe(why, "look at the run's folder; its report is made by `koordgen report`")
    return [_sample(np.array(poses[pid]), *gone[pid], probe.offset, times) for pid in sorted(poses)]


def _sample(poses: Array, at: float, target: Sequence[float], offset: Vector, times: Array) -> tuple[Array, Array]:
    t, yaw = poses[:, 0], np.unwrap(poses[:, 4])
    if t[-1] < at + times[-1]:
        raise BadProbe(f"a probe's run ended {at + times[-1] - t[-1]:.2f} s early")
    origin = np.array(target) - np.array(offset)

    def place(when: Array) -> Array:
        found: Array = np.stack([np.interp(when, t, poses[:, axis]) for axis in (1, 2, 3)], axis=-1) - origin
        return found

    way = place(at + times)
    velocity = (place(np.array([at + STATE])) - place(np.array([at - STATE])))[0] / (2 * STATE)
    return way, np.array([*way[0], *velocity, float(np.interp(at, t, yaw))])
