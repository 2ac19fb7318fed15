"""The user's own planner and `avoid`, from the fleet file to a process in the bundle."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from koordgen.build.bundle.write import write
from koordgen.build.pipeline import Rejected, plan_file

EXAMPLE = Path(__file__).parents[3] / "examples/lineform"
MINE = """
class Mine:
    def __init__(self, world):
        self.world = world

    def plan(self, start, goal, scene, seconds):
        print("thinking")
        return (start, goal)
"""
RUN = """
import time
from koordgen.runtime.config.settings import Box
from koordgen.runtime.values.points import Point
from targets.planning.process import Beside, made
from targets.planning.world import Scene, World

planning = Beside("routes.mine:Mine", World(Box(Point(-5, -5, 1), Point(5, 5, 3))), 1.0)
made(planning, time.sleep)
path = planning.plan(Point(0, 0, 2), Point(1, 1, 2), Scene())
planning.close()
print(path, planning.log_lines())
"""


def files(folder: Path, planner: str, extra: str = "", text: str = MINE) -> Path:
    (folder / "lineform.koord").write_bytes((EXAMPLE / "lineform.koord").read_bytes())
    fleet = (EXAMPLE / "fleet.yaml").read_text().replace("{flight_height: 1.5}", f"{{planner: '{planner}'}}")
    assert planner in fleet
    (folder / "fleet.yaml").write_text(fleet + extra)
    (folder / "routes").mkdir()
    (folder / "routes/mine.py").write_text(text)
    return folder


def planned(folder: Path) -> dict[str, dict[str, bytes]]:
    return plan_file(str(folder / "lineform.koord"), ["quad"], str(folder / "fleet.yaml"), {})[1]


def refused(folder: Path) -> list[tuple[str, str]]:
    with pytest.raises(Rejected) as rejected:
        planned(folder)
    return [(d.code, d.message) for _, d in rejected.value.found]


def test_its_file_goes_into_the_bundle_and_its_process_finds_it(tmp_path: Path) -> None:
    bundles = planned(files(tmp_path, "routes.mine:Mine", "avoid: x\n"))
    name, bundle = next((name, b) for name, b in bundles.items() if "routes/mine.py" in b)
    settings = json.loads(bundle["settings.json"])
    assert settings["avoid"] == "x" and settings["body"]["planner"] == "routes.mine:Mine"
    write({name: bundle}, tmp_path / "out")
    done = subprocess.run(
        [sys.executable, "-c", RUN], cwd=tmp_path / "out" / name, capture_output=True, text=True, timeout=60
    )
    assert done.stdout == "(Point(x=0.0, y=0.0, z=2.0), Point(x=1.0, y=1.0, z=2.0)) []\n", done.stderr


@pytest.mark.parametrize(
    ("planner", "text", "said"),
    [
        ("routes.mine:Yours", MINE, "routes/mine.py has no class Yours"),
        ("routes.yours:Mine", MINE, "routes/yours.py, which should have the class Mine"),
        ("routes.mine:Mine", MINE.replace("def plan", "def route"), "Mine in routes/mine.py has no method plan"),
        (
            "routes.mine:Mine",
            MINE.replace("self, world", "self"),
            "the class Mine in routes/mine.py cannot be constructed with one argument",
        ),
        ("routes.mine:Mine", "import nothing_there", "routes/mine.py cannot be imported: ModuleNotFoundError"),
        ("koordgen.mine:Mine", MINE, "every bundle has a file with this name"),
        ("dijkstra", MINE, "planner cannot be 'dijkstra'"),
    ],
)
def test_one_that_cannot_serve_is_refused_at_its_place(tmp_path: Path, planner: str, text: str, said: str) -> None:
    found = refused(files(tmp_path, planner, text=text))
    assert found and all(code == "F005" and said in message for code, message in found), found


@pytest.mark.parametrize("name", ["y", "lineform"])
def test_what_is_to_be_avoided_must_be_published(tmp_path: Path, name: str) -> None:
    ((code, message),) = refused(files(tmp_path, "rrt", f"avoid: {name}\n"))
    assert code == "F005" and f"avoid is '{name}'" in message and message.endswith("possible values: x")
