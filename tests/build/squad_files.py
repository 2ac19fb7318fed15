"""Fleet files with squads, and their programs, for tests: two squads of three quads each line up with a car."""

from __future__ import annotations

from pathlib import Path

LINEFORM = Path(__file__).parents[2] / "examples/lineform/lineform.koord"
TRIANGLE = """\
provides Motion:
  sensors:
    Point position = middle(corner)
    bool reached = distance(middle(corner), goal) < near
  actuators: Point target = goal
using Motion:
  sensors: Point position
  actuators: Point target
param float radius = 0.8
param float near = 0.2
allwrite: Point goal = Point(0, 0, 1.5)
allread: Point corner[N_SYS]
fun middle(List<Point> ps) -> Point:
  Point sum = Point(0, 0, 0)
  for p in ps:
    sum = sum + p
  return sum / max(len(ps), 1)
init:
  corner[pid] = Motion.position
Keep:
  pre: True
  eff:
    float angle = 6.2831853 * pid / N_SYS
    Motion.target = goal + Point(radius * cos(angle), radius * sin(angle), 0)
    corner[pid] = Motion.position
"""
WORLD = """\
origin: {latitude: 47.397742, longitude: 8.545594, altitude: 488.0}
geofence: {lo: [-8.0, -8.0, -0.5], hi: [8.0, 8.0, 4.0]}
insecure: true
"""
OUTER = f"""\
delta: 0.3
{WORLD}robots:
  - {{name: alpha, inner: alpha.yaml}}
  - {{name: dora, target: car, address: 127.0.0.1:47100, start: {{position: [0.0, 3.0, 0.0]}}}}
  - {{name: beta, inner: beta.yaml}}
"""


def inner_fleet(names: tuple[str, ...], number: int) -> str:
    """Return the file of an inner fleet. `number`: 1 to 9, another one for each fleet."""
    robots = "".join(
        f"  - {{name: {name}, target: quad, address: 127.0.0.1:{47000 + 100 * number + k}, "
        f"start: {{position: [{-4.0 + 4 * number}, {2.0 * k}, 0.0]}}}}\n"
        for k, name in enumerate(names)
    )
    applications = "applications: [{name: triangle, program: triangle.koord}]\n"
    return f"delta: 0.1\napplication_id: {number}\n{WORLD}{applications}robots:\n{robots}"


def fleet_files(folder: Path, outer: str = OUTER) -> Path:
    """Write the outer fleet file, those of its squads and the inner program into a folder. Return the outer file."""
    (folder / "triangle.koord").write_text(TRIANGLE)
    (folder / "alpha.yaml").write_text(inner_fleet(("ann", "bob", "cyd"), 2))
    (folder / "beta.yaml").write_text(inner_fleet(("eve", "fay", "gus"), 3))
    (folder / "outer.yaml").write_text(outer)
    return folder / "outer.yaml"
