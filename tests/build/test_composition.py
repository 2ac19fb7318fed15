"""Applications of a fleet file: each error stands in the file in which it is mended, and names the other side."""

from __future__ import annotations

from pathlib import Path

import pytest

from koordgen.build.pipeline import Rejected, check_system, read_fleet
from koordgen.fleet import manifest
from koordgen.lang.semantics.composition import Instance
from tests.programs import QUAD_AND_CAR

MAPPING = """\
export:
  List<int> found
  write List<Task> done
  int place[N_SYS]
def Task:
  Point where
  int kind
spec fun good(int a) -> bool
param int limit = 4
using Motion:
  sensors: Point position
  actuators: Point target
allwrite:
  List<int> found max 20
  List<Task> done max 20 = []
  int hidden
allread: int place[N_SYS]
Go:
  pre: place[pid] < limit and hidden < 9
  eff: place[pid] = place[pid] + 1
"""
TASK = """\
def Task:
  Point where
  int kind
import Mapping:
  List<int> found max 20
  write List<Task> done max 20
  int place[Mapping.N_SYS]
  spec fun good(int a) -> bool
using Motion:
  sensors: Point position
local: int seen
Go:
  pre: len(found) > seen and Mapping.pid < 0
  eff: seen = len(found)
"""
ENTRIES = """\
  - {name: mapping, program: mapping.koord, robots: [bert], params: {limit: 7}}
  - {name: task, program: task.koord, import: {Mapping: mapping}}
"""


def fleet(folder: Path, entries: str = ENTRIES, task: str = TASK, mapping: str = MAPPING, more: str = "") -> str:
    (folder / "mapping.koord").write_text(mapping)
    (folder / "task.koord").write_text(task)
    (folder / "fleet.yaml").write_text(QUAD_AND_CAR + entries + more)
    return str(folder / "fleet.yaml")


def errors(path: str) -> list[str]:
    """Return each error as `FILE:LINE: CODE MESSAGE | HELP`, without folders."""
    with pytest.raises(Rejected) as rejected:
        check_system(path)
    folder = f"{Path(path).parent}/"
    return [
        f"{source.path}:{d.span.line}: {d.code} {d.message} | {d.help}".replace(folder, "")
        for source, d in rejected.value.found
    ]


def test_programs_members_and_params_become_a_system(tmp_path: Path) -> None:
    system = check_system(fleet(tmp_path)).system
    mapping, task = system.applications
    assert (mapping.name, mapping.members, task.name, task.members) == ("mapping", (1,), "task", (0, 1))
    assert task.bindings == (("Mapping", "mapping"),)
    assert [getattr(p.default, "value", None) for p in mapping.program.params] == [7]
    assert system.instances() == (Instance(0, 0, 1), Instance(1, 0, 0), Instance(1, 1, 1))


def test_a_fleet_has_at_most_1024_instances(tmp_path: Path) -> None:
    (tmp_path / "a.koord").write_text("local: int k\nGo:\n  pre: k < 1\n  eff: k = 1\n")
    text = f"{QUAD_AND_CAR.partition('robots:')[0]}robots:\n"
    text += "".join(f"  - {{name: r{k}, target: quad, address: '127.0.0.1:{20000 + k}'}}\n" for k in range(128))
    lines = [f"  - {{name: a{k}, program: a.koord}}\n" for k in range(8)]
    (tmp_path / "fleet.yaml").write_text(text + "applications:\n" + "".join(lines))
    assert len(check_system(str(tmp_path / "fleet.yaml")).system.instances()) == 1024
    lines += ["  - {name: more, program: a.koord, robots: [r7]}\n"]
    (tmp_path / "fleet.yaml").write_text(text + "applications:\n" + "".join(lines))
    (error,) = errors(str(tmp_path / "fleet.yaml"))
    assert error.startswith(f"fleet.yaml:{text.count(chr(10)) + 10}: F005 with application more, the robots run 1025")
    assert "at most 1024" in error and "give robots fewer applications" in error


def test_one_program_may_be_two_applications(tmp_path: Path) -> None:
    task = TASK.replace("Mapping", "Other")
    entries = """\
  - {name: first, program: mapping.koord, robots: [bert]}
  - {name: second, program: mapping.koord, robots: [alice]}
  - {name: task, program: task.koord, import: {Mapping: second}}
"""
    assert "imports nothing under the name Mapping | its imports: Other" in "\n".join(
        errors(fleet(tmp_path, entries, task))
    )
    checked = check_system(fleet(tmp_path, entries))
    assert checked.system.exporter(2, checked.system.applications[2].program.imports[0]) == 1


@pytest.mark.parametrize(
    ("before", "after", "error"),
    [
        ("List<int> found max 20\n  write", "write List<int> found max 20\n  write",
         "task.koord:5: B012 mapping exports found for reading only (mapping.koord:2) | remove `write`"),
        ("done max 20", "done max 21",
         "task.koord:6: B012 done is not imported as mapping exports it (mapping.koord:3): the exported capacity "
         "is 20, the imported one 21 | write `List<Task> done max 20`"),
        ("int place[Mapping.N_SYS]", "float place[Mapping.N_SYS]",
         "task.koord:7: B012 place is not imported as mapping exports it (mapping.koord:4): the exported "
         "type is int, the imported one float | write `int place[Mapping.N_SYS]`"),
        ("int place[Mapping.N_SYS]", "int place",
         "task.koord:7: B012 place is not imported as mapping exports it (mapping.koord:4): the exported variable "
         "is allread"),
        ("  List<int> found max 20\n", "  List<int> found max 20\n  int hidden\n",
         "task.koord:6: B012 mapping exports no variable hidden | write it under `export:` in mapping.koord; its "
         "declaration is mapping.koord:16"),
        ("  List<int> found max 20\n", "  List<int> found max 20\n  int nowhere\n",
         "task.koord:6: B012 mapping exports no variable nowhere | mapping.koord exports: found, done, place"),
        ("good(int a) -> bool", "good(float a) -> bool",
         "task.koord:8: B012 the spec function good has other parameters or another result in mapping "
         "(mapping.koord:8)"),
        ("good(int a) -> bool", "bad(int a) -> bool",
         "task.koord:8: B012 mapping has no spec function bad | mapping.koord has: good"),
        ("  int kind\n", "  float kind\n",
         "task.koord:6: B012 done is not imported as mapping exports it (mapping.koord:3): in the field kind of the "
         "record Task, the exported type is int, the imported one float"),
        ("  int kind\n", "  int sort\n",
         "task.koord:6: B012 done is not imported as mapping exports it (mapping.koord:3): the exported record "
         "Task has the fields where, kind, the imported one where, sort"),
        ("  sensors: Point position", "  sensors: Point position\n  actuators: Point target",
         "task.koord:9: B013 task and mapping both have actuators of bert: Motion at mapping.koord:10"),
        ("Point position", "Pose position",
         "task.koord:10: B003 Motion.position has type Point on target quad, but Pose in the program"),
    ],
)  # fmt: skip
def test_what_a_program_imports_must_be_exported(before: str, after: str, error: str, tmp_path: Path) -> None:
    assert before in TASK
    assert error in "\n".join(errors(fleet(tmp_path, task=TASK.replace(before, after))))


def test_a_capacity_within_a_record_must_be_equal(tmp_path: Path) -> None:
    a, b = (text.replace("int kind", f"string kind max {n}") for n, text in ((9, MAPPING), (8, TASK)))
    (error,) = errors(fleet(tmp_path, mapping=a, task=b))
    assert "in the field kind of the record Task, the exported capacity is 9, the imported one 8" in error


@pytest.mark.parametrize(
    ("before", "after", "error"),
    [
        (", import: {Mapping: mapping}", "",
         "fleet.yaml:10: F003 the import Mapping of task.koord:4 is bound to no application | write `import: "
         "{Mapping: APPLICATION}` in the entry of task"),
        ("Mapping: mapping", "Mapping: maping",
         "fleet.yaml:10: F005 Mapping is bound to 'maping', which is no application of the fleet | applications: "
         "mapping, task"),
        ("Mapping: mapping", "Mapping: task",
         "fleet.yaml:10: F005 applications import from one another in a cycle: task -> task"),
        ("limit: 7", "limit: x", "fleet.yaml:9: F004 param limit is of type int; 'x' does not fit"),
        ("limit: 7", "limi: 7", "fleet.yaml:9: F004 mapping.koord has no param 'limi'"),
        ("robots: [bert]", "robots: [zed]",
         "fleet.yaml:9: F005 application mapping names 'zed', which is no robot of the fleet | robots: alice, bert"),
        ("robots: [bert]", "robots: [bert, bert]", "fleet.yaml:9: F006 application mapping names the robot bert twice"),
        ("robots: [bert]", "robots: []", "fleet.yaml:9: F005 application mapping has no robots"),
        ("name: task", "name: mapping", "fleet.yaml:10: F006 application 0 is called mapping as well"),
        ("name: task", "name: Task", "fleet.yaml:10: F005 'Task' cannot be an application's name"),
        ("name: task, ", "", "fleet.yaml:10: F003 application 1 lacks 'name'"),
        ("name: task", "nmae: task", "fleet.yaml:10: F002 unknown key 'nmae' in application 1"),
        ("robots: [bert]", "robots: [bert], share: 0", "fleet.yaml:9: F005 application mapping's share is 0"),
        ("robots: [bert]", "robots: [bert], share: 1.5", "fleet.yaml:9: F005 application mapping's share is 1.5; it"),
        ("robots: [bert]", "robots: [bert], share: 1",
         "fleet.yaml:9: F005 the shares on bert, those of mapping, add up to 1, which leaves nothing for an"),
        ("program: task.koord", "program: nothing.koord", "nothing.koord:1: F100 the file cannot be read"),
        ("program: task.koord", "robots: [alice]",
         "fleet.yaml:10: F003 application 1 lacks 'program'"),
    ],
)  # fmt: skip
def test_the_fleet_file_binds_programs_that_are_there(before: str, after: str, error: str, tmp_path: Path) -> None:
    assert before in ENTRIES
    assert error in "\n".join(errors(fleet(tmp_path, ENTRIES.replace(before, after))))


def test_shares_on_a_robot_are_at_most_one(tmp_path: Path) -> None:
    entries = ENTRIES.replace("limit: 7}", "limit: 7}, share: 0.7").replace(
        "{Mapping: mapping}", "{Mapping: mapping}, share: 0.5"
    )
    (error,) = errors(fleet(tmp_path, entries))
    assert error.startswith(
        "fleet.yaml:10: F005 the shares on bert, those of mapping and task, add up to 1.2; at most 1"
    )
    check_system(fleet(tmp_path, entries.replace("0.5", "0.3")))


def test_each_robot_runs_an_application(tmp_path: Path) -> None:
    alone = "  - {name: mapping, program: mapping.koord, robots: [bert]}\n"
    assert "fleet.yaml:9: F005 the robot alice runs no application" in errors(fleet(tmp_path, alone))[0]


def test_a_cycle_over_two_applications_is_reported_once(tmp_path: Path) -> None:
    mapping = "import Tasks:\n  int other\n" + MAPPING
    task = TASK + "export:\n  int other\nallwrite: int other\n"
    entries = ENTRIES.replace("limit: 7}", "limit: 7}, import: {Tasks: task}")
    (error,) = errors(fleet(tmp_path, entries, task, mapping))
    assert "in a cycle: mapping -> task -> mapping" in error


def test_names_of_an_application_begin_with_its_name(tmp_path: Path) -> None:
    mapping = MAPPING.replace("int place", "Point place").replace("place[pid] < limit and ", "")
    mapping = mapping.replace("place[pid] + 1", "Motion.position") + "invariant Low: hidden < 10\n"
    task = TASK.replace("  int place[Mapping.N_SYS]\n", "")
    right = "avoid: mapping.place\nmonitors: {mapping.Low: stop}\n"
    check_system(fleet(tmp_path, task=task, mapping=mapping, more=right))
    found = errors(fleet(tmp_path, task=task, mapping=mapping, more="avoid: place\nmonitors: {Low: stop}\n"))
    assert any(
        "no allread variable place of type Point or List<Point>; possible values: mapping.place" in e for e in found
    )
    assert any("unknown key 'Low' in monitors | possible keys: default, mapping.Low" in e for e in found)


def test_params_that_are_wrong_together_are_refused(tmp_path: Path) -> None:
    """Each value fits the declaration alone; both together make a first value that is too large."""
    declared = "param Point far = Point(1, 1, 0)\nparam float size = 0.5\n"
    mapping = MAPPING.replace("param int limit = 4\n", f"param int limit = 4\n{declared}").replace(
        "  int hidden\n", "  int hidden\n  GridMap map max 64 = GridMap(Point(0, 0, 0), far, size)\n"
    )
    wrong = ENTRIES.replace("{limit: 7}", "{far: [4.0, 4.0, 0.0], size: 0.25}")
    (error,) = errors(fleet(tmp_path, wrong, mapping=mapping))
    assert error.startswith("fleet.yaml:") and "F005 with these params the initial value of map" in error


def test_params_of_the_whole_fleet_are_refused(tmp_path: Path) -> None:
    (error,) = errors(fleet(tmp_path, more="params: {limit: 3}\n"))
    assert error.startswith("fleet.yaml:11: F005 params of several applications do not stand here | move each param")


def test_errors_of_all_programs_come_at_once(tmp_path: Path) -> None:
    wrong = [text.replace("eff: ", "eff: nothing = ", 1) for text in (MAPPING, TASK)]
    assert {error.split(":")[0] for error in errors(fleet(tmp_path, mapping=wrong[0], task=wrong[1]))} == {
        "mapping.koord", "task.koord",
    }  # fmt: skip


def test_a_fleet_file_without_applications(tmp_path: Path) -> None:
    assert "fleet.yaml:8: F004 applications must be a list" in errors(fleet(tmp_path, ""))[0]
    (tmp_path / "fleet.yaml").write_text(QUAD_AND_CAR.replace("applications:\n", ""))
    assert "F003 the fleet file names no program" in errors(str(tmp_path / "fleet.yaml"))[0]


def test_a_program_beside_a_fleet_file_with_applications(tmp_path: Path) -> None:
    targets = {name: manifest.load(name) for name in manifest.available()}
    path = fleet(tmp_path)
    program = check_system(path).system.applications[0].program
    with pytest.raises(Rejected) as rejected:
        read_fleet(path, targets, program, "mapping.koord")
    ((_, error),) = rejected.value.found
    assert "names the programs of its applications" in error.message and path in error.help


def test_the_number_of_an_exporters_members_is_no_param(tmp_path: Path) -> None:
    entries = ENTRIES.replace("{Mapping: mapping}", "{Mapping: mapping}, params: {Mapping.N_SYS: 3}")
    (error,) = errors(fleet(tmp_path, entries))
    assert error.startswith("fleet.yaml:10: F005 Mapping.N_SYS is the number of robots that run an application")


def test_records_within_tuples_must_be_equal(tmp_path: Path) -> None:
    mapping = MAPPING.replace("List<Task> done", "List<(int, Task)> done")
    task = TASK.replace("List<Task> done", "List<(int, Task)> done")
    check_system(fleet(tmp_path, task=task, mapping=mapping))
    (error,) = errors(fleet(tmp_path, task=task.replace("int kind", "bool kind"), mapping=mapping))
    assert "in the field kind of the record Task, the exported type is int, the imported one bool" in error


HVAC = """\
using HVAC:
  sensors: float temp
  actuators: bool heat
"""


def test_each_module_with_a_driver_is_a_body_of_its_own(tmp_path: Path) -> None:
    more = "modules: {HVAC: drivers:Hvac}\n"
    check_system(fleet(tmp_path, task=TASK + HVAC, more=more))
    found = errors(fleet(tmp_path, task=TASK + HVAC, mapping=MAPPING + HVAC, more=more))
    assert [error.split(": ")[:2] for error in found] == [
        ["task.koord:15", "B013 task and mapping both have actuators of bert"]
    ]


def test_applications_declare_a_sensor_of_one_robot_alike(tmp_path: Path) -> None:
    other = "using HVAC:\n  sensors: int temp\n"
    (error,) = errors(
        fleet(tmp_path, task=TASK + other, mapping=MAPPING + HVAC, more="modules: {HVAC: drivers:Hvac}\n")
    )
    assert error.startswith(
        "task.koord:16: B013 HVAC.temp is declared in another way in mapping.koord, for the same robot"
    )


def test_what_is_wrong_on_several_robots_is_reported_once(tmp_path: Path) -> None:
    task = TASK.replace("position\n", "position\n  actuators: Point target\n")
    everywhere = ENTRIES.replace("robots: [bert], ", "")
    (error,) = errors(fleet(tmp_path, everywhere, task))
    assert error.startswith("task.koord:9: B013")
    (error,) = errors(
        fleet(
            tmp_path, everywhere.replace("limit: 7}", "limit: 7}, share: 0.6").replace("task, ", "task, share: 0.6, ")
        )
    )
    assert "the shares on alice, those of mapping and task, add up to 1.2" in error


def test_all_modules_of_a_target_are_one_body(tmp_path: Path) -> None:
    task = TASK.replace("using Motion:", "using MotionWithScan:").replace(
        "position\n", "position\n  actuators: Point target\n"
    )
    found = errors(fleet(tmp_path, task=task))
    assert any(
        "B013 task and mapping both have actuators of bert: Motion at mapping.koord:10" in error for error in found
    )


def test_the_order_of_robots_in_the_fleet_file_gives_their_pids(tmp_path: Path) -> None:
    entries = ENTRIES.replace("program: task.koord", "program: task.koord, robots: [bert, alice]")
    assert check_system(fleet(tmp_path, entries)).system.applications[1].members == (0, 1)
