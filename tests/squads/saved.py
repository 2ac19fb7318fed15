"""Folders with the traces of outer fleets and their squads, as a simulated run leaves them."""

from __future__ import annotations

import json
from pathlib import Path

from benchmarks.fixtures.fleet import NAMES
from koordgen.build.emit.program import program_hash
from koordgen.build.pipeline import check_part
from koordgen.runtime.trace.schema import FORMAT, ApplicationRecord, End, Header, RobotName
from targets.sim.trace import files
from tests.build.squad_files import TRIANGLE
from tests.squads.levels import INNER, OUTER, Levels

FENCE = ((-6.0, -5.0, -0.5), (6.0, 5.0, 4.0))


def save(folder: Path, levels: Levels, text: str) -> Path:
    """Write the traces of both levels, and their programs. `text`: the outer program. Return the folder."""
    outer = _source(folder / "source", "app", text)
    robots = tuple([RobotName(NAMES[p], p, "squad" if size else "fake") for p, size in enumerate(levels.sizes)])
    _merge(folder, levels, -1, Header(FORMAT, "app", outer, OUTER, 0, robots, geofence=FENCE, applications=("app",)))
    for squad, size in enumerate(levels.sizes):
        if size:
            own = folder / NAMES[squad]
            inner = _source(own / "source" / "triangle", "triangle", TRIANGLE)
            members = tuple(range(size))
            robots = tuple([RobotName(NAMES[p], p, "fake") for p in members])
            composition = (
                ApplicationRecord("triangle", members, {v: f"triangle.{v}" for v in ("goal", "corner")}),
                ApplicationRecord("outer", members, {"goal": "triangle.goal"}),
            )
            names = ("triangle", "outer")
            header = Header(
                FORMAT, "triangle", inner, INNER, 0, robots, applications=names, composition=composition, geofence=FENCE
            )
            _merge(own, levels, squad, header)
    return folder


def _source(folder: Path, name: str, text: str) -> str:
    """Write a program. Return its hash."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.koord").write_text(text)
    return program_hash(check_part(str(folder / f"{name}.koord")).program)


def _merge(folder: Path, levels: Levels, squad: int, header: Header) -> None:
    """Write the traces of the robots of a fleet with times of one clock, and the merged trace."""
    paths = []
    for robot in header.robots:
        path = folder / "robots" / robot.name / "trace.jsonl"
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("w") as file:
            for clock, data in levels.files.get((squad, robot.pid), []):
                for line in data.getvalue().decode().splitlines():
                    record = json.loads(line)
                    if "time" in record:
                        record["time"] = clock.true(record["time"])
                    file.write(json.dumps(record, separators=(",", ":")) + "\n")
        paths.append(path)
    poses = folder / "poses.jsonl"
    poses.write_bytes(b"")
    files.merge(folder / "trace.jsonl", header, 0.0, poses, paths, [End(levels.time.time, "completed")])
