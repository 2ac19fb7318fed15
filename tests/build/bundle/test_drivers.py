"""Driver classes named in a fleet file are checked before the build writes anything."""

from __future__ import annotations

from pathlib import Path

import pytest

from koordgen.build.bundle.drivers import check_drivers, driver_files
from koordgen.fleet import manifest
from koordgen.fleet.settings import DriverClass
from tests.build.emit.generated import checked

PROGRAM = checked(
    "using HVAC:\n"
    "  sensors:\n    float temp\n    List<Point> spots\n"
    "  actuators: bool heat\n"
    "E:\n  pre: HVAC.temp > 3\n  eff: HVAC.heat = len(HVAC.spots) > 0\n"
)
HVAC = DriverClass("drivers.hvac", "Hvac")
RIGHT = """
class Hvac:
    sensors = {"temp": "float", "spots": "List<Point>", "more": "int"}
    actuators = {"heat": "bool"}
    def sense(self): return {}
    def command(self, actuators): pass
"""


def told(folder: Path, text: str | None, driver: DriverClass = HVAC) -> list[tuple[int, str]]:
    if text is not None:
        (folder / "drivers").mkdir()
        (folder / "drivers/hvac.py").write_text(text)
    drivers = {"HVAC": driver, "Other": DriverClass("not.there", "X")}
    files = driver_files(drivers, PROGRAM, [folder / "elsewhere", folder])
    found = check_drivers(PROGRAM, drivers, files, (manifest.load("car"),))
    assert all(d.code == "B005" for d in found)
    return [(d.span.line, d.message) for d in found]


def test_a_right_driver(tmp_path: Path) -> None:
    assert told(tmp_path, RIGHT) == []


@pytest.mark.parametrize(
    ("old", "new", "line", "message"),
    [
        ("class Hvac", "class Havc", 1, "drivers/hvac.py has no class Hvac"),
        ('"temp": "float"', '"tmp": "float"', 3, "the driver Hvac of HVAC has no sensor temp"),
        ('"temp": "float"', '"temp": "int"', 3, "HVAC.temp has type int in the driver Hvac, but float in the program"),
        ('"heat": "bool"', "", 5, "the driver Hvac of HVAC has no actuator heat"),
        ('{"heat": "bool"}', "3", 1, "Hvac.actuators must be a dict from names of ports to Koord types"),
        ("def sense(self)", "def look(self)", 1, "the class Hvac in drivers/hvac.py has no method sense"),
        (
            "def sense",
            "def __init__(self, pin): pass\n    def sense",
            1,
            "the class Hvac in drivers/hvac.py cannot be constructed without",
        ),
        ("class", "import no_such\nclass", 1, "drivers/hvac.py cannot be imported: ModuleNotFoundError"),
        ("class", "import sys\nsys.exit('no')\nclass", 1, "drivers/hvac.py cannot be imported: SystemExit: no"),
    ],
)
def test_what_is_wrong_is_told(tmp_path: Path, old: str, new: str, line: int, message: str) -> None:
    ((at, said),) = told(tmp_path, RIGHT.replace(old, new))
    assert (at, said[: len(message)]) == (line, message)


def test_no_file(tmp_path: Path) -> None:
    ((line, message),) = told(tmp_path, None)
    assert line == 1 and message.endswith("drivers/hvac.py, which should have the driver of HVAC")


def test_a_link_out_of_the_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "out.py").write_text(RIGHT)
    (tmp_path / "in/own.py").symlink_to(tmp_path / "out.py")
    ((_, message),) = told(tmp_path / "in", None, DriverClass("own", "Hvac"))
    assert message.endswith("own.py is a link to a file outside of its folder")


@pytest.mark.parametrize(
    "module", ["koordgen.runtime.agent.process", "program", "targets.car", "__main__", "a_functions"]
)
def test_a_file_of_the_bundle_is_never_replaced(tmp_path: Path, module: str) -> None:
    ((_, message),) = told(tmp_path, None, DriverClass(module, "Hvac"))
    assert message.startswith("a driver's file cannot have the name")


def test_a_module_of_the_target_has_no_driver() -> None:
    program = checked(
        "using Motion:\n  actuators: Point target\nE:\n  pre: True\n  eff: Motion.target = Point(1, 1, 0)\n"
    )
    drivers = {"Motion": DriverClass("own", "Own")}
    (found,) = check_drivers(program, drivers, driver_files(drivers, program, [Path(".")]), (manifest.load("car"),))
    assert found.message == "Motion is a module of target car and can have no driver"
