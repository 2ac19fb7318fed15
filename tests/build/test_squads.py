"""Squads of a fleet: each misfit of an inner fleet is reported at its place, with a way out."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from koordgen.build.pipeline import Rejected, check_file, read_fleet
from koordgen.fleet import manifest
from koordgen.fleet.file import Fleet
from tests.build.squad_files import LINEFORM, OUTER, WORLD, fleet_files, inner_fleet

TARGETS = {name: manifest.load(name) for name in manifest.available()}


def read(path: Path, program: Path | None = LINEFORM) -> Fleet:
    checked = None if program is None else check_file(str(program)).program
    return read_fleet(str(path), TARGETS, checked, str(program or ""), squads=True)[0]


def errors(path: Path, program: Path | None = LINEFORM) -> list[str]:
    with pytest.raises(Rejected) as rejected:
        read(path, program)
    return [
        f"{Path(source.path).name}:{d.span.line}:{d.span.column}: {d.code} {d.message} | {d.help}"
        for source, d in rejected.value.found
    ]


def changed(folder: Path, file: str, before: str, after: str) -> Path:
    """Write the files of the fleet, with one text in one file replaced. Return the outer fleet file."""
    outer = fleet_files(folder)
    text = (folder / file).read_text()
    assert before in text
    (folder / file).write_text(text.replace(before, after))
    return outer


@pytest.mark.parametrize("program", [LINEFORM, None])
def test_the_robots_of_a_squad_have_ports_of_their_own_for_the_outer_fleet(
    program: Path | None, tmp_path: Path
) -> None:
    outer = read(fleet_files(tmp_path), program)
    alpha, dora, beta = outer.robots
    assert alpha.inner is not None and beta.inner is not None and dora.inner is None
    assert alpha.inner.addresses == tuple([("127.0.0.1", 49200 + k) for k in range(3)])
    assert (beta.host, beta.port) == ("127.0.0.1", 49300)
    assert [robot.name for robot in outer.inner_fleets["alpha"].robots] == ["ann", "bob", "cyd"]


def test_listed_ports_are_used(tmp_path: Path) -> None:
    ports = "inner: alpha.yaml, ports: [10.0.0.1:9, 10.0.0.2:9, 10.0.0.3:9]"
    squad = read(changed(tmp_path, "outer.yaml", "inner: alpha.yaml", ports)).robots[0]
    assert squad.inner is not None and squad.inner.addresses[2] == ("10.0.0.3", 9)


@pytest.mark.parametrize(
    ("file", "before", "after", "error"),
    [
        ("outer.yaml", "delta: 0.3", "delta: 0.2",
         "outer.yaml:6:26: F005 a round of 0.2 s is too short for alpha: it takes 3 rounds of alpha.yaml, which are "
         "0.1 s long | write `delta: 0.3` or more here, or a "),
        ("outer.yaml", "inner: alpha.yaml", "inner: alpha.yaml, ports: [127.0.0.1:9]",
         "outer.yaml:6:45: F005 the ports of alpha are 1 addresses, but alpha.yaml has 3 robots | list one"),
        ("outer.yaml", "inner: beta.yaml", "inner: alpha.yaml",
         "outer.yaml:8:25: F006 alpha.yaml is the fleet of alpha already | give beta a fleet file of its own"),
        ("outer.yaml", "insecure: true", "insecure: true\nnetwork: {transport: broadcast, group: 10.0.0.255}",
         "outer.yaml:7:26: F005 a fleet with squads needs the transport unicast, not broadcast | remove `network`"),
        ("alpha.yaml", "application_id: 2", "",
         "outer.yaml:6:26: F005 alpha.yaml and outer.yaml have the same application_id, 0 | write another"),
        ("alpha.yaml", "application_id: 2", "application_id: 3",
         "outer.yaml:8:25: F005 beta.yaml and alpha.yaml have the same application_id, 3 | write another"),
        ("beta.yaml", "longitude: 8.545594", "longitude: 8.5455",
         "outer.yaml:8:25: F005 the origin of beta.yaml is not that of this file, so positions would mean other "),
        ("alpha.yaml", "127.0.0.1:47201", "127.0.0.1:47100",
         "outer.yaml:6:26: F006 127.0.0.1:47100 is the address of bob in alpha.yaml, and the address of dora | give"),
        ("alpha.yaml", "127.0.0.1:47201", "127.0.0.1:48302, control: 9",
         "outer.yaml:8:25: F006 127.0.0.1:48302 is the control port of gus in beta.yaml, and the address of bob in "),
        ("outer.yaml", "inner: beta.yaml", "inner: beta.yaml, ports: [127.0.0.1:9, 127.0.0.1:49201, 127.0.0.1:8]",
         "outer.yaml:8:57: F006 127.0.0.1:49201 is the address of beta's fay in this fleet, and the address of "),
        ("alpha.yaml", "name: triangle, program", "name: outer, program",
         "alpha.yaml:6:23: F005 no application of a squad can be called 'outer'"),
        ("alpha.yaml", "applications: [{name: triangle, program: triangle.koord}]", "",
         "alpha.yaml:1:1: F003 the fleet of alpha names no program | list programs under `applications:`"),
        ("outer.yaml", "name: alpha", "name: plots",
         "outer.yaml:6:12: F005 'plots' cannot be the name of a squad: it is a folder of each run | give the squad "),
        ("alpha.yaml", "{name: ann, target: quad, address: 127.0.0.1:47200, start: {position: [4.0, 0.0, 0.0]}}",
         "{name: ann, inner: beta.yaml}",
         "outer.yaml:6:26: F005 the fleet of alpha has a robot that is a fleet itself, "),
        ("alpha.yaml", "{name: ann, target: quad, address: 127.0.0.1:47200, start: {position: [4.0, 0.0, 0.0]}}",
         "{name: ann, inner: outer.yaml}",
         "outer.yaml:6:26: F005 the fleet of alpha contains itself: "),
        ("outer.yaml", "inner: alpha.yaml", "inner: outer.yaml",
         "outer.yaml:6:26: F005 the fleet of alpha contains itself: "),
    ],
)  # fmt: skip
def test_inner_fleets_that_do_not_fit(file: str, before: str, after: str, error: str, tmp_path: Path) -> None:
    found = errors(changed(tmp_path, file, before, after))
    assert len(found) == 1, found
    assert found[0].startswith(error), found[0]


def test_an_inner_fleet_file_that_is_not_there(tmp_path: Path) -> None:
    (found,) = errors(changed(tmp_path, "outer.yaml", "alpha.yaml", "nowhere.yaml"))
    assert found.startswith("outer.yaml:6:26: F005 there is no file ") and "to be the fleet of alpha" in found


def test_applications_and_squads_exclude_each_other(tmp_path: Path) -> None:
    outer = f"{OUTER}applications: [{{name: line, program: {LINEFORM}}}]\n"
    (tmp_path / "triangle.koord").write_text("")
    found = errors(fleet_files(tmp_path, outer), None)
    assert all("a fleet with `applications` cannot have a robot that is a fleet itself" in each for each in found)


PROVIDED = "provides Motion:\n  sensors:\n    Point position = middle(corner)\n"


@pytest.mark.parametrize(
    ("before", "after", "error"),
    [
        ("provides Motion:", "provides Drive:",
         "lineform.koord:3:1: B014 the robot alpha has no module Motion: "),
        ("Point position = middle(corner)", "Point place = middle(corner)",
         "lineform.koord:4:18: B014 Motion.position, a sensor of type Point, is not provided, but the robot "),
        ("Point position = middle(corner)", "float position = 1.0",
         "lineform.koord:4:18: B014 Motion.position is of type Point here and float there"),
        ("actuators: Point target = goal\nusing", "sensors: Point target = goal\nusing",
         "lineform.koord:5:20: B014 Motion.target is an actuator here, and not there"),
    ],
)  # fmt: skip
def test_an_inner_program_must_provide_the_ports(before: str, after: str, error: str, tmp_path: Path) -> None:
    (found,) = errors(changed(tmp_path, "triangle.koord", before, after))
    assert found.startswith(error), "both squads have the same error, which is reported once"
    assert "triangle.koord" in found
    read(tmp_path / "outer.yaml", None)  # nothing is known of the outer program


@pytest.mark.parametrize(
    ("port", "error"),
    [
        ("Motion:\n  PathPlanner planner", "Motion.planner is a callable port, which a fleet cannot provide"),
        ("Log:\n  stream line", "the robot alpha has no module Log"),
        ("Motion:\n  sensors: List<float> seen", "Motion.seen is of type List<float> max 4096 here and List<int> m"),
        ("Motion:\n  sensors: (int, Task) task", "Motion.task is of type (int, Task), whose class is another one in"),
    ],
)
def test_ports_that_no_fleet_can_provide(port: str, error: str, tmp_path: Path) -> None:
    provided = PROVIDED + "    List<int> seen = [1]\n    (int, Task) task = (1, Task(1))\n"
    outer = changed(tmp_path, "triangle.koord", PROVIDED, f"def Task: int number\n{provided}")
    program = tmp_path / "app.koord"
    program.write_text(f"def Task: int number\nusing {port}\nlocal: bool k\nGo:\n  pre: not k\n  eff: k = True\n")
    (found,) = errors(outer, program)
    assert error in found


def test_one_program_of_an_inner_fleet_provides_the_modules(tmp_path: Path) -> None:
    (found,) = errors(changed(tmp_path, "alpha.yaml", "program: triangle.koord", "program: other.koord"))
    assert found.startswith("other.koord:1:1: F100")
    (tmp_path / "other.koord").write_text("local: bool k\nGo:\n  pre: not k\n  eff: k = True\n")
    (found,) = errors(tmp_path / "outer.yaml")
    assert found.startswith("outer.yaml:6:26: F005 no application of alpha.yaml provides a module")
    two = "{name: triangle, program: triangle.koord}, {name: second, program: second.koord}"
    sensors = "provides Drive:\n  sensors: bool k = True\nlocal: bool k\nGo:\n  pre: not k\n  eff: k = True\n"
    (tmp_path / "second.koord").write_text(sensors)
    (found,) = errors(changed(tmp_path, "alpha.yaml", "{name: triangle, program: triangle.koord}", two))
    assert "several applications of alpha.yaml provide modules: triangle and second" in found


def test_squads_are_refused_unless_they_are_supported(tmp_path: Path) -> None:
    with pytest.raises(Rejected) as rejected:
        read_fleet(str(fleet_files(tmp_path)), TARGETS, None)
    ((_, found),) = rejected.value.found
    assert found.message == "alpha is a fleet itself, which this command does not support"
    assert (found.span.line, found.span.column) == (6, 26)


def test_the_example_of_the_page_fits(tmp_path: Path) -> None:
    page = (LINEFORM.parents[2] / "docs/reference/fleet.md").read_text()
    section = page[page.index("## A fleet as one robot") :]
    outer, alpha = re.findall(r"```yaml\n(# \w+.yaml\n.*?)```", section, re.DOTALL)
    path = fleet_files(tmp_path, f"{outer}delta: 0.3\n{WORLD}")
    (tmp_path / "alpha.yaml").write_text(f"{alpha}{WORLD}")
    (tmp_path / "beta").mkdir()
    (tmp_path / "beta/fleet.yaml").write_text(
        inner_fleet(("eve", "fay", "gus"), 3).replace("triangle.k", "../triangle.k")
    )
    squads = read(path).squads
    assert [(squad.name, squad.host, squad.port) for squad in squads] == [
        ("alpha", "192.168.1.41", 49100), ("beta", "10.0.0.1", 49000),
    ]  # fmt: skip
