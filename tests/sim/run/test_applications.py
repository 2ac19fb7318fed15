"""Runs of fleets with several applications: built from the fleet file, and judged application by application."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from koordgen.cli import main
from targets.sim.base.scenario import BadScenario
from targets.sim.harness import _check_windows
from targets.sim.trace.files import read
from targets.sim.trace.store_names import StoreNames
from tests.sim.view.browser import CHROMIUM, Browser

CARS = """\
using Motion:
  sensors: Point position
export:
  write int done
    guarantee More: done <= done'
  Point place[N_SYS]
allwrite:
  int done = 0
  int mine = 0
allread: Point place[N_SYS]
local: int count = 0
Go:
  pre: count < 8
  eff: atomic:
    count += 1
    place[pid] = Motion.position
    done += 1
End:
  pre: count >= 8
  eff: stop
invariant Few: done <= 5
invariant Many: done >= 0
"""
QUADS = """\
import Cars:
  int done
  Point place[Cars.N_SYS]
using Motion:
  sensors: Point position
  actuators: Point target
local:
  int count = 0
  float east
Look:
  pre: count < 8
  eff:
    count = done
    east = place[0].x
End:
  pre: count >= 8
  eff: stop
invariant Few: done <= 100
invariant East: forall i in ID: abs(east[i]) < 3
"""
FLEET = """\
delta: 0.1
origin: {latitude: 47.397742, longitude: 8.545594, altitude: 488.0}
geofence: {lo: [-8, -7, -0.5], hi: [8, 7, 4.0]}
insecure: true
robots:
  - {name: alice, target: quad, address: "127.0.0.1:47100", start: {position: [-1, 0, 0]}, sim: {fidelity: simple}}
  - {name: bert, target: car, address: "127.0.0.1:47101", start: {position: [2, 0, 0]}, sim: {fidelity: simple}}
applications:
  - {name: cars, program: cars.koord, robots: [BERT]}
  - {name: quads, program: quads.koord, robots: [alice], import: {Cars: cars}}
"""


def fleet(folder: Path, cars: str = "bert") -> str:
    folder.mkdir(exist_ok=True)
    (folder / "cars.koord").write_text(CARS)
    (folder / "quads.koord").write_text(QUADS)
    (folder / "fleet.yaml").write_text(FLEET.replace("BERT", cars))
    return str(folder / "fleet.yaml")


def sim(file: str, out: Path, *options: str) -> tuple[int, dict[str, Any]]:
    status = main(["sim", file, "--lockstep", "--duration", "3", "--quiet", "--out", str(out), *options])
    return status, json.loads((out / "summary.json").read_text())


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """A run in which both robots run `cars`, and alice runs `quads` as well. It has a report."""
    folder = tmp_path_factory.mktemp("two")
    status, summary = sim(fleet(folder, "alice, bert"), folder / "run")
    assert status == 3, summary["why"]
    return folder / "run", summary


def test_a_violated_property_is_named_with_its_application(run: tuple[Path, dict[str, Any]]) -> None:
    _, summary = run
    assert summary["app"] == "cars+quads" and "invariant cars.Few does not hold: done = 6" in summary["why"]
    assert {p["name"]: p["outcome"] for p in summary["properties"]} == {
        "cars.Few": "violated",
        "cars.Many": "held",
        "cars.More": "held",
        "quads.Few": "held",
        "quads.East": "held",
    }
    assert {v["application"] for v in summary["violations"]} == {"cars"}
    assert [m["name"] for m in summary["monitors"]] == ["cars.Few"] and summary["monitors"][0]["mistaken"] == []


def test_events_of_a_robot_are_counted_for_each_of_its_applications(run: tuple[Path, dict[str, Any]]) -> None:
    alice, bert = run[1]["robots"]
    assert alice["events"]["cars.Go"] == bert["events"]["cars.Go"] == 8
    assert alice["events"]["quads.Look"] > 1 and alice["events"]["quads.End"] == 1
    assert set(bert["events"]) == {"cars.Go", "cars.End"}
    assert alice["rounds"] == bert["rounds"] and alice["faults"] == 0


def test_the_trace_has_each_record_with_its_application_and_pages_the_names_of_the_store(
    run: tuple[Path, dict[str, Any]],
) -> None:
    lines = [json.loads(line) for line in (run[0] / "trace.jsonl").read_text().splitlines()]
    header, rounds = lines[0], [line for line in lines if line["kind"] == "round"]
    assert header["applications"] == ["cars", "quads"] and header["composition"][0]["members"] == [0, 1]
    assert [v["name"] for v in header["shared"]] == ["cars.done", "cars.mine", "cars.place"]
    assert {(r["pid"], r["application"]) for r in rounds} == {(0, "cars"), (0, "quads"), (1, "cars")}
    assert {r["event"] for r in rounds if r.get("event")} == {"Go", "Look", "End"}
    read_header, records = read(run[0] / "trace.jsonl")
    shown = [r for r in records if getattr(r, "event", None)]
    assert {r.event for r in shown} == {"cars.Go", "cars.End", "quads.Look", "quads.End"}  # type: ignore[union-attr]
    assert {n for r in shown for n in r.copy} == {"cars.done", "cars.mine", "cars.place"}  # type: ignore[union-attr]
    assert all(StoreNames(read_header).of(r) is r for r in shown if not getattr(r, "application", ""))
    report = (run[0] / "report.html").read_text()
    assert "cars.Few" in report and "quads.Look" in report


def test_a_csv_row_of_a_round_has_its_application(run: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    assert main(["export", str(run[0]), "--to", "csv", "--out", str(tmp_path / "csv")]) == 0
    with (tmp_path / "csv" / "rounds.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {(r["robot"], r["application"]) for r in rows} == {("alice", "cars"), ("alice", "quads"), ("bert", "cars")}
    assert all(r["event"].startswith(r["application"]) for r in rows if r["event"])
    assert any(r["skipped"] and r["application"] == "quads" for r in rows)


@pytest.mark.skipif(CHROMIUM is None, reason="no browser: on Debian, apt install chromium")
def test_the_report_shows_slots_of_members_only_with_their_pids(tmp_path: Path) -> None:
    """Bert, robot 1, is the only member of `cars`: its pid there is 0."""
    sim(fleet(tmp_path), tmp_path / "run")
    with Browser(tmp_path / "profile") as page:
        page.open(f"file://{tmp_path}/run/report.html")
        assert "cars.place[0]\tbert" in page.text("shared")
        assert page.text("shared").count("cars.place") == 1


def test_an_audit_judges_each_application_of_the_run(
    run: tuple[Path, dict[str, Any]], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["audit", str(run[0])]) == 3
    cars, quads = capsys.readouterr().out.split("quads: quads.koord, 1 of 1 robots")
    assert "invariant Few is violated (cars.koord:21)" in cars and "is violated" not in quads


def test_a_run_of_several_applications_is_deterministic(tmp_path: Path) -> None:
    file = fleet(tmp_path)
    traces = []
    for name in ("a", "b"):
        status, _ = sim(file, tmp_path / name, "--seed", "4", "--no-report", "--loss", "0.1")
        assert status == 3
        traces.append((tmp_path / name / "trace.jsonl").read_bytes())
    assert traces[0] == traces[1]


def test_a_fleet_file_in_place_of_a_program_names_the_folders(tmp_path: Path, capsys: Any) -> None:
    file = fleet(tmp_path / "survey")
    assert main(["build", file, "-o", str(tmp_path / "build")]) == 0
    assert {p.name for p in (tmp_path / "build" / "survey").iterdir()} == {"alice", "bert", "fleet"}
    other = tmp_path / "survey" / "small.yaml"
    other.write_text(Path(file).read_text())
    assert main(["build", str(other), "-o", str(tmp_path / "build"), "--target", "sim"]) == 0
    assert (tmp_path / "build" / "small" / "sim" / "scenario.json").is_file()


def test_a_missing_functions_file_is_reported_in_its_program(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = fleet(tmp_path)
    (tmp_path / "quads.koord").write_text("extern fun twice(int n) -> int\n" + QUADS.replace("= done", "= twice(done)"))
    assert main(["build", file, "-o", str(tmp_path / "build")]) == 1
    said = capsys.readouterr().err
    assert "quads_functions.py" in said and not (tmp_path / "build").exists()
    assert "help: write it in the folder of " in said and "--functions" not in said


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--param", "count=3"], "--param needs a program"),
        (["--functions", "x.py"], "--functions needs a program"),
    ],
)
def test_options_of_one_program_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], message: str
) -> None:
    assert main(["sim", fleet(tmp_path), *options]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.slow
def test_a_campaign_counts_the_violations_of_an_application(tmp_path: Path) -> None:
    out = str(tmp_path / "campaign")
    options = ["--vary", "seed=1:2", "--lockstep", "--duration", "3", "--quiet", "--out", out]
    assert main(["campaign", fleet(tmp_path, "alice, bert"), *options]) == 3
    found = json.loads((tmp_path / "campaign" / "campaign.json").read_text())
    assert found["violated"] == 2 and "invariant cars.Few" in found["reasons"][0]["why"]


ASSUMES = "  actuators: Point target\n  assume position' in Ball(target, 9)\n"


def assuming(folder: Path, cars: str = "") -> str:
    """Return a fleet file whose application `quads`, and `cars` with its text, have assumptions; bert runs `quads`."""
    file = fleet(folder, "alice")
    (folder / "quads.koord").write_text(QUADS.replace("  actuators: Point target\n", ASSUMES))
    (folder / "cars.koord").write_text(
        CARS.replace("  sensors: Point position\n", f"  sensors: Point position\n{cars}")
    )
    (folder / "fleet.yaml").write_text(
        Path(file).read_text().replace("robots: [alice], import", "robots: [bert], import")
    )
    return file


@pytest.mark.slow
def test_assumptions_of_one_application_are_validated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    words = ["validate", assuming(tmp_path), "--samples", "2", "--seconds", "2", "--quiet", "--out", str(out)]
    assert main([*words, "--format", "json"]) == 4
    found = json.loads(capsys.readouterr().out)
    assert found["program"].endswith("quads.koord") and found["fleet"].endswith("fleet.yaml")
    (one,) = found["assumptions"]
    assert (one["platform"], one["runs"], one["violated"]) == ("car simple", 2, 0)
    head, *rows, _ = [json.loads(line) for line in (out / "runs/0000/windows.jsonl").read_text().splitlines()]
    assert [r["name"] for r in head["robots"]] == ["bert"] and {row["pid"] for row in rows} == {0}
    assert abs(rows[0]["start"][0] - 2) < 0.1 and set("".join(row["came"] for row in rows)) == {"h"}


@pytest.mark.parametrize(
    ("more", "options", "status", "said"),
    [
        (ASSUMES, [], 2, "choose one of cars, quads with --application"),
        ("", ["--application", "cars"], 2, "no application cars with assumptions"),
        ("", ["--param", "x=1"], 2, "--param needs a program"),
    ],
)
def test_validate_says_which_application_it_needs(
    more: str, options: list[str], status: int, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["validate", assuming(tmp_path, more), "--samples", "1", *options]) == status
    assert said in capsys.readouterr().err


def test_an_application_is_named_only_with_a_fleet_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fleet_file = fleet(tmp_path)
    words = ["validate", str(tmp_path / "cars.koord"), "--fleet", fleet_file, "--application", "cars"]
    assert main(words) == 2 and "--application needs a fleet file" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("names", "given", "fits"),
    [
        ("ab", "b", True),
        ("", "", True),
        ("ab", None, True),
        ("ab", "", False),
        ("ab", "c", False),
        ("", "a", False),
    ],
)
def test_windows_are_those_of_one_application(names: str, given: str | None, fits: bool) -> None:
    scenario: Any = SimpleNamespace(applications=[SimpleNamespace(name=name) for name in names])
    if fits:
        _check_windows(scenario, given)
    else:
        with pytest.raises(BadScenario, match="--windows: "):
            _check_windows(scenario, given)


@pytest.mark.slow
def test_agents_of_several_applications_run_as_processes(tmp_path: Path) -> None:
    file = fleet(tmp_path, "alice, bert")
    out = tmp_path / "run"
    assert main(["sim", file, "--duration", "3", "--quiet", "--no-report", "--out", str(out)]) in (3, 6)
    summary = json.loads((out / "summary.json").read_text())
    assert summary["robots"][0]["events"]["quads.End"] == 1
    assert {p["name"]: p["outcome"] for p in summary["properties"]}["quads.East"] == "held"
