"""Proof time of a composition and of its parts: `python benchmarks/proof_composition.py [--quick] [--json FILE]`.

Each composition is proved in one process, in turns with its applications alone. An application that imports is proved
alone with the interface of its exporter, as in the composition. Seconds are wall-clock time with one solver that runs
already. Printed are medians, the ratio, and how much longer the composition took than the sum of its parts.
"""

from __future__ import annotations

import argparse
import gc
import json
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from koordgen.build.pipeline import check_system
from koordgen.lang.semantics.composition import System
from koordgen.verify.prove.report.composition import prove_application, prove_system
from koordgen.verify.prove.smt.solve import Limits, Solver

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
FLEET = """\
delta: 0.2
insecure: true
origin: {{latitude: 47.4, longitude: 8.5, altitude: 488.0}}
geofence: {{lo: [-9, -9, 0], hi: [9, 9, 3]}}
robots:
{robots}
applications:
{applications}
"""
ROBOT = "  - {{name: {name}, target: quad, address: '127.0.0.1:4720{at}', start: {{position: [{at}, 0, 1]}}}}"
WATCH = """\
param Point lo = Point(-9, -9, 0)
param Point hi = Point(9, 9, 3)

using Motion:
  sensors: Point position
  assume position' in Rect(lo, hi)

local: Point seen = lo

Watch:
  pre: True
  eff: seen = Motion.position

initially: lo in Rect(lo, hi)
initially: forall i in ID: Motion.position[i] in Rect(lo, hi)

invariant Bounded: forall i in ID: Motion.position[i] in Rect(lo, hi)
invariant Inside: forall i in ID: seen[i] in Rect(lo, hi)
"""
PROGRAMS = {  # composition -> its programs, which share no variable
    "geofence + watch": ("lineform/geofence", "watch"),
    "task + watch": ("task/separation", "watch"),
    "task + mapping": ("task/separation", "mapping/mapping"),
    "geofence + task + mapping": ("lineform/geofence", "task/separation", "mapping/mapping"),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    gc.disable()  # as the command does
    repeats = 3 if options.quick else 5
    figures = {}
    with Solver("z3", Limits()) as solver, tempfile.TemporaryDirectory() as folder:
        systems = {"survey": check_system(str(EXAMPLES / "survey" / "fleet.yaml")).system}
        for name, programs in PROGRAMS.items():
            systems[name] = _composed(Path(folder), programs)
        for name, system in systems.items():
            figures[name] = _figures(system, solver, repeats)
            print(f"{name:28} {_text(figures[name])}", flush=True)
    if options.json:
        options.json.write_text(json.dumps(figures, indent=2) + "\n")


def _composed(folder: Path, programs: tuple[str, ...]) -> System:
    """Return a fleet whose programs run on two robots each; `watch` runs on the robots of the first program."""
    robots, applications, owners = list[str](), list[str](), [program for program in programs if program != "watch"]
    for number, program in enumerate(owners):
        robots += [ROBOT.format(name=name, at=len(robots) + i) for i, name in enumerate(_robots(program))]
        applications.append(_entry(f"part{number}", EXAMPLES / f"{program}.koord", _robots(program)))
    if "watch" in programs:
        (folder / "watch.koord").write_text(WATCH)
        applications.append(_entry("watch", folder / "watch.koord", _robots(owners[0])))
    path = folder / "fleet.yaml"
    path.write_text(FLEET.format(robots="\n".join(robots), applications="\n".join(applications)))
    return check_system(str(path)).system


def _robots(program: str) -> list[str]:
    return [f"{Path(program).name}{robot}" for robot in range(2)]


def _entry(name: str, program: Path, robots: list[str]) -> str:
    return f"  - {{name: {name}, program: {program}, robots: [{', '.join(robots)}]}}"


def _figures(system: System, solver: Solver, repeats: int) -> dict[str, float]:
    parts, whole = [], []
    for _ in range(repeats + 1):  # the first turn warms up
        parts.append(sum(_seconds(prove_application, system, i, solver) for i in range(len(system.applications))))
        whole.append(_seconds(prove_system, system, solver))
    one, other = statistics.median(parts[1:]), statistics.median(whole[1:])
    return {"parts_s": one, "composition_s": other, "ratio": other / one, "more_ms": (other - one) * 1e3}


def _seconds(proof: Callable[..., object], *given: object) -> float:
    gc.collect()
    began = time.perf_counter()
    proof(*given)
    return time.perf_counter() - began


def _text(found: dict[str, float]) -> str:
    return (
        f"parts {found['parts_s'] * 1e3:6.0f} ms, composition {found['composition_s'] * 1e3:6.0f} ms, "
        f"ratio {found['ratio']:.2f}, {found['more_ms']:+.0f} ms"
    )


if __name__ == "__main__":
    main()
