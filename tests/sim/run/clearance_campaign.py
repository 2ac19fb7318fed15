"""Paths and targets amid obstacles in lockstep, with freezes, holds, restarts and losses: does a body touch?

    python -m tests.sim.run.clearance_campaign --from 0 --count 500 --folder build/clearance
    python -m tests.sim.run.clearance_campaign --scenes targets --from 0 --count 100 --folder build/clearance-targets

Each seed is one run of a small fleet of quads and cars at fidelity `full`: along planned paths through doors, windows
and pillars, or, in the scene `targets`, after targets that are set every round, near to pillars and in them. Results go
into `results-FROM.jsonl`, one line a seed; called again with the same `--from`, the command goes on behind the last
line. Bundle and trace of a run in which anything touched stay in the folder. Several slices may run at once.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import shutil
import time
from argparse import ArgumentParser
from collections.abc import Iterator, Sequence
from pathlib import Path
from random import Random
from typing import Any

from koordgen.cli import main as koordgen
from targets.sim import harness

DURATION = 20.0  # seconds of each mission
NORTH, SOUTH = (5.4, 6.8), (1.2, 2.6)  # metres: where starts and goals lie, on both sides of the wall
ROOM = 8.0  # metres: the sides of the square arena
TARGETS = ("quad", "car")
WALL = (3.95, 4.05)  # metres: the faces of the wall
NAMES, COLUMNS = ("ann", "bob"), (2.0, 6.0)  # robots, and the metres from west of their starts and goals
HIGH = 3.1  # metres, higher than the geofence
EACH = 150  # targets of a robot: rounds
SIZE = {"quad": 0.2, "car": 0.14}  # metres: half of a robot's width

PROGRAM = """\
# Each robot goes to `each` goals along planned paths, and is held by its monitor for a while when it is startled.
param List<Point> goals max 24 = [Point(0, 0, 0)]
param List<int> startles max 24 = [0]  # beats, `each` for each robot; a negative one never comes
param int each = 2
param int calming = 15  # beats: rounds in which nothing else is to do
param float apart = 0.9  # metres between paths

fun isClear(List<Point> paths[N_SYS], List<Point> path, int me) -> bool:
  for i in range(len(paths)):
    if i != me and path_distance(path, paths[i]) <= apart: return False
  return True

using Motion:
  actuators: List<Point> path
  sensors:
    Point position
    bool reached
  PathPlanner planner

local:
  int leg = 0
  int startle = 0
  int beats = 0
  bool going = False
  bool calm = True
  int wait = 0
  List<Point> mine max 40

allread:
  List<Point> ways[N_SYS] max 40

init:
  Motion.path = [Motion.position]
  ways[pid] = [Motion.position]

Startle:
  pre: calm and startle < each and startles[pid * each + startle] >= 0 and beats >= startles[pid * each + startle]
  eff: calm = False

Calm:
  pre: not calm and startle < each and beats >= startles[pid * each + startle] + calming
  eff:
    calm = True
    startle += 1

Arrive:
  pre: going and Motion.reached
  eff: atomic:
    going = False
    leg += 1
    ways[pid] = [last(mine)]

Rest:
  pre: wait > 0
  eff: wait -= 1

Plan:
  pre: not going and leg < each and wait == 0
  eff: atomic:
    mine = Motion.planner(goals[pid * each + leg])
    if len(mine) > 0 and isClear(ways, mine, pid):
      going = True
      ways[pid] = mine
      Motion.path = mine
    else:
      wait = 7 + 3 * pid

Beat:
  pre: True
  eff: beats += 1

invariant Calm: forall i in ID: calm[i]
"""

FOLLOWING = """\
# Each robot is given a target in every round.
param List<Point> targets max 300 = [Point(0, 0, 0)]
param int each = 1

using Motion:
  actuators: Point target
  sensors: Point position

local:
  int beats = 0

init:
  Motion.target = targets[pid * each]

Follow:
  pre: beats < each
  eff: atomic:
    Motion.target = targets[pid * each + beats]
    beats += 1
"""


def box(lo: tuple[float, float, float], hi: tuple[float, float, float]) -> dict[str, Any]:
    """An obstacle of the fleet file."""
    return {"lo": [round(v, 3) for v in lo], "hi": [round(v, 3) for v in hi]}


def pillar(x: float, y: float, radius: float) -> dict[str, Any]:
    """An obstacle as high as the walls."""
    return {"base": [round(x, 3), round(y, 3), 0.0], "radius": round(radius, 3), "height": HIGH}


def robot(pid: int, target: str, place: tuple[float, float], yaw: float) -> dict[str, Any]:
    """A robot of the fleet file, with its start."""
    start = {"position": [*place, 0.0], "yaw": round(yaw, 3)}
    return {"name": NAMES[pid], "target": target, "address": f"127.0.0.1:{47100 + pid}", "start": start}


def wall_with(west: float, east: float) -> list[dict[str, Any]]:
    """The wall with a door between two places, as high as the wall."""
    low, high = WALL
    return [box((0.0, low, 0.0), (west, high, HIGH)), box((east, low, 0.0), (ROOM, high, HIGH))]


def door(dice: Random) -> list[dict[str, Any]]:
    """A door for quads and cars."""
    middle, half = dice.uniform(2.0, 6.0), dice.uniform(0.6, 0.8)
    return wall_with(middle - half, middle + half)


def window(dice: Random) -> list[dict[str, Any]]:
    """A low door for cars, and a window for quads."""
    low, high = WALL
    cars, quads = dice.sample((1.9, 4.0, 6.1), 2)
    half, wide = dice.uniform(0.5, 0.7), dice.uniform(0.6, 0.8)
    sill, lintel = dice.uniform(0.7, 0.9), dice.uniform(2.1, 2.4)
    holes = sorted(((cars - half, cars + half), (quads - wide, quads + wide)))
    ends = [0.0, *(place for hole in holes for place in hole), ROOM]
    solid = [box((a, low, 0.0), (b, high, HIGH)) for a, b in zip(ends[::2], ends[1::2], strict=True)]
    return [
        *solid,
        box((cars - half, low, 0.6), (cars + half, high, HIGH)),
        box((quads - wide, low, 0.0), (quads + wide, high, sill)),
        box((quads - wide, low, lintel), (quads + wide, high, HIGH)),
    ]


def pillars(dice: Random) -> list[dict[str, Any]]:
    """Pillars in two rows, with room between them."""
    found = []
    for y in (3.4, 4.6):
        x = dice.uniform(0.4, 1.6)
        while x < ROOM - 0.3:
            radius = dice.uniform(0.12, 0.25)
            found.append(pillar(x, y + dice.uniform(-0.1, 0.1), radius))
            x += dice.uniform(1.5, 2.1)
    return found


PATHS = {"door": door, "window": window, "pillars": pillars}
SCENES = (*sorted(PATHS), "targets")


def fleet(dice: Random, scene: str) -> dict[str, Any]:
    """The fleet file of a seed: two robots, each with a goal beyond the wall and one back."""
    robots, goals, startles = [], [], []
    for pid, x in enumerate(COLUMNS):
        target = dice.choice(TARGETS)
        z = 0.0 if target == "car" else dice.uniform(1.4, 1.7)
        there, here = dice.choice(((NORTH, SOUTH), (SOUTH, NORTH)))

        def place(band: tuple[float, float], x: float = x, z: float = z) -> list[float]:
            return [round(x + dice.uniform(-0.7, 0.7), 3), round(dice.uniform(*band), 3), round(z, 3)]

        start = place(here)
        robots.append(robot(pid, target, (start[0], start[1]), dice.uniform(-3.1, 3.1)))
        goals += [place(there), place(here)]
        scared = sorted(dice.randint(10, 150) for _ in range(dice.randint(0, 2)))
        startles += scared + [-1] * (2 - len(scared))
    more = {"avoid": "ways", "planner_budget": 0.05, "monitors": {"Calm": "hold"}}
    return common(robots, {"goals": goals, "startles": startles}, PATHS[scene](dice)) | more


def common(robots: list[dict[str, Any]], params: dict[str, Any], obstacles: list[dict[str, Any]]) -> dict[str, Any]:
    """What all fleet files have."""
    return {
        "delta": 0.1,
        "origin": {"latitude": 47.4, "longitude": 8.5, "altitude": 488.0},
        "geofence": {"lo": [0.0, 0.0, -0.5], "hi": [ROOM, ROOM, 3.0]},
        "params": params,
        "robots": robots,
        "sim": {"boot": 0.5},
        "obstacles": obstacles,
    }


def following(dice: Random) -> dict[str, Any]:
    """The fleet file of a seed: each robot has half of the room for itself, and follows targets among pillars."""
    robots, targets, obstacles = [], [], []
    for pid, x in enumerate(COLUMNS):
        target = dice.choice(TARGETS)
        z = 0.0 if target == "car" else 1.5
        here = (x, 1.0)
        places = [(x + dice.uniform(-1.4, 1.4), y + dice.uniform(-0.3, 0.3)) for y in (2.8, 4.6, 6.4)]
        radii = [dice.uniform(0.15, 0.5) for _ in places]
        obstacles += [pillar(*place, radius) for place, radius in zip(places, radii, strict=True)]
        robots.append(robot(pid, target, here, dice.uniform(-3.1, 3.1)))
        near = [(*place, radius + SIZE[target]) for place, radius in zip(places, radii, strict=True)]
        targets += [[round(p, 3), round(q, 3), z] for p, q in moving(dice, here, x, near)]
    found = common(robots, {"targets": targets, "each": EACH}, obstacles)
    found["sim"]["position_noise"] = dice.choice((0.005, 0.02))
    return found


def moving(
    dice: Random, here: tuple[float, float], x: float, near: list[tuple[float, float, float]]
) -> Iterator[tuple[float, float]]:
    """Targets of all rounds: each jumps or glides to the next place. `near` are circles (x, y, radius) by which many of
    these lie; a robot with a target on a circle just touches the pillar."""
    left = EACH
    while left > 0:
        a, b, radius = dice.choice(near)
        turn, away = dice.uniform(-math.pi, math.pi), radius + dice.uniform(-0.1, 0.5)
        there = (a + away * math.cos(turn), b + away * math.sin(turn))
        there = (max(x - 1.7, min(x + 1.7, there[0])), max(0.5, min(ROOM - 0.5, there[1])))
        steps = dice.randint(4, 30)
        if dice.random() < 0.5:
            steps = max(1, round(math.dist(here, there) / (0.1 * dice.uniform(0.3, 1.1))))
        glides = dice.random() < 0.5
        for i in range(1, min(steps, left) + 1):
            share = i / steps if glides else 1.0
            yield here[0] + share * (there[0] - here[0]), here[1] + share * (there[1] - here[1])
        left -= steps
        here = there


def faults(dice: Random) -> dict[str, Any]:
    """The scenario file of a seed: freezes, a crash with a restart, a partition, and losses."""
    end = DURATION - 4.0
    events: list[dict[str, Any]] = []
    for name in NAMES:
        t = dice.uniform(1.0, 6.0)
        while t < end and dice.random() < 0.7:
            what = "crash" if dice.random() < 0.3 else "freeze"
            lasts = dice.uniform(0.2, 3.0)
            events.append({"at": round(t, 2), what: name, "for": round(lasts, 2)})
            t += lasts + dice.uniform(1.0, 8.0)
    if dice.random() < 0.3:
        groups = [[name] for name in NAMES]
        events.append({"at": round(dice.uniform(1.0, end), 2), "for": 2.0, "partition": groups})
    return {"network": {"loss": round(dice.choice((0.0, 0.1, 0.3)), 2), "jitter": 0.005}, "events": events}


def simulated(
    folder: Path, fleet: dict[str, Any], faults: dict[str, Any], seed: int, duration: float, program: str = PROGRAM
) -> Any:
    """Build and run a fleet in lockstep; `folder` gets program, fleet file, bundle and run. The summary. Raises
    RuntimeError when it cannot be run."""
    files = {"tour.koord": program, "fleet.yaml": json.dumps(fleet), "faults.json": json.dumps(faults)}
    for name, text in files.items():
        (folder / name).write_text(text)
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        fleet_file, build = str(folder / "fleet.yaml"), str(folder / "build")
        status = koordgen(["build", f"{folder}/tour.koord", "--fleet", fleet_file, "--target", "sim", "-o", build])
        if not status:
            status = harness.main(
                folder / "build" / "tour" / "sim",
                ["--lockstep", "--duration", f"{duration:g}", "--seed", str(seed), "--no-report", "--quiet",
                 "--scenario", f"{folder}/faults.json", "--out", f"{folder}/run"],
            )  # fmt: skip
    if status not in (harness.HELD, harness.VIOLATED):
        raise RuntimeError(f"seed {seed}: status {status}\n{said.getvalue()}")
    return json.loads((folder / "run" / "summary.json").read_text())


def ran(seed: int, folder: Path, duration: float = DURATION, scenes: Sequence[str] = tuple(PATHS)) -> dict[str, Any]:
    """Run one seed. `contacts` are those of the mission: a quad that lands in a window after it stands on a sill."""
    dice = Random(seed)
    scene = sorted(scenes)[seed % len(scenes)]
    began = time.process_time()
    if scene in PATHS:
        made, meanwhile, program = fleet(dice, scene), faults(dice), PROGRAM
    else:
        made, meanwhile, program = following(dice), {}, FOLLOWING
    meanwhile["events"] = [event for event in meanwhile.get("events", []) if event["at"] + event["for"] < duration]
    summary = simulated(folder, made, meanwhile, seed, duration, program)
    found: dict[bool, list[str]] = {True: [], False: []}
    for v in summary["violations"]:
        if v["what"] != "property":  # a robot that is startled
            contact = v["what"] == "collision" and v["t"] <= duration
            found[contact].append(f"{v['t']:.2f} {v['what']} {' and '.join(v['robots'])}: {v['detail']}")
    return {
        "seed": seed,
        "scene": scene,
        "targets": [robot["target"] for robot in summary["robots"]],
        "contacts": found[True],
        "others": found[False],
        "held": [line for name in NAMES for line in told(folder / "run" / "robots" / name / "log.txt")],
        "arrived": [robot["events"].get("Arrive", 0) for robot in summary["robots"]],
        "seconds": round(time.process_time() - began, 2),
    }


def told(log: Path) -> list[str]:
    """The lines of a robot that holds because it finds no way or makes no progress."""
    wanted = ("no clear way", "no progress", "holding instead")
    return [line for line in log.read_text().splitlines() if any(words in line for words in wanted)]


def slice_of(first: int, count: int, folder: Path, scenes: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Results of these seeds, those of an earlier call included."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"results-{first}.jsonl"
    done = [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []
    yield from done
    for seed in range(first + len(done), first + count):
        own = folder / f"seed-{seed}"
        shutil.rmtree(own, ignore_errors=True)
        own.mkdir()
        result = ran(seed, own, scenes=scenes)
        with file.open("a") as out:
            out.write(json.dumps(result) + "\n")
        if not result["contacts"]:
            shutil.rmtree(own)
        yield result


def main() -> int:
    """Run a slice of seeds; 1 when anything touched."""
    parser = ArgumentParser(description="Runs paths through doors, windows and pillars, and counts contacts.")
    parser.add_argument("--from", dest="first", type=int, default=0)
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--folder", type=Path, default=Path("build/clearance"))
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=tuple(PATHS))
    options = parser.parse_args()
    touched = 0
    for runs, result in enumerate(slice_of(options.first, options.count, options.folder, options.scenes), 1):
        touched += bool(result["contacts"])
        print(f"{runs} runs, {touched} with a contact: {json.dumps(result)}", flush=True)
    return 1 if touched else 0


if __name__ == "__main__":
    raise SystemExit(main())
