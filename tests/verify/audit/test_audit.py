"""`koordgen audit`: verdicts on a whole fleet by its robots' traces, unknown values, assumptions of proofs."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from koordgen.cli import main
from koordgen.runtime.values.points import Point
from tests.verify.audit.fleets import LINE, audited, by_name, conditions, saved, watched
from tests.verify.replay.runs import Run

WHOLE = LINE + (
    "invariant Near: forall i in ID: distance(x[i], Motion.position[i]) < 9\n"
    "invariant Sum: sum <= 9\n"
    "invariant Mine: forall i in ID: mine[i] <= 6\n"
)
HOLDS = WHOLE.replace("sum <= 9", "sum <= 99")


def home_of(folder: Path, text: str, seconds: float = 3.0) -> Path:
    fleet = watched(folder, text).run(seconds)
    for robot in fleet.fleet.robots.values():
        robot.agent.end("SIGTERM: stopping safely")
    fleet.fleet.run(1.0)
    return saved(folder, fleet, text)


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fleet that does what it should."""
    return home_of(tmp_path_factory.mktemp("flown"), HOLDS)


@pytest.fixture
def home(flown: Path, tmp_path: Path) -> Path:
    shutil.copytree(flown, tmp_path / "home")
    return tmp_path / "home"


def text_of(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str]:
    status = main(["audit", *map(str, arguments)])
    told = capsys.readouterr()
    return status, told.out + told.err


def edit(path: Path, change: Callable[[dict[str, Any]], dict[str, Any] | None]) -> None:
    """Every record anew, or none for None."""
    records = [change(json.loads(line)) for line in path.read_text().splitlines()]
    path.write_text("".join(json.dumps(r, separators=(",", ":")) + "\n" for r in records if r is not None))


def test_a_fleet_that_kept_to_its_program_is_held(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, told = text_of(capsys, home)
    assert status == 0 and told.startswith("a.koord, 3 of 3 robots, ")
    rows = [line.split() for line in told.splitlines()[3:]]
    assert [row[0] for row in rows] == ["held"] * 7, told
    status, document = audited(home / "bert.jsonl", home / "cleo.jsonl", home / "alice.jsonl")
    assert status == 0 and [r["name"] for r in document["robots"]] == ["alice", "bert", "cleo"]
    assert {p["unknown"] for p in document["properties"]} == {0} and not document["notes"]


def test_the_first_violation_is_told_with_its_place_and_values(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    home = home_of(tmp_path, WHOLE)
    status, told = text_of(capsys, home)
    assert status == 3 and "invariant Sum is violated (a.koord:" in told and "sum = 10" in told
    found = by_name(audited(home)[1])["Sum"]
    line = next(k for k, text in enumerate(WHOLE.splitlines(), 1) if text.startswith("invariant Sum"))
    assert found["line"] == line and found["first"]["robots"] == []
    assert found["first"]["rows"] == [{"robot": "", "variable": "sum", "before": "9", "after": "10"}]
    wrote = next(
        record["round"]
        for path in sorted(home.glob("*.jsonl"))
        for record in map(json.loads, path.read_text().splitlines())
        if record.get("shared", {}).get("sum") == 10
    )
    assert found["first"]["round"] == wrote and found["first"]["seconds"] == pytest.approx((wrote - 1) * 0.1)
    assert [s["outcome"] for s in found["spans"]] == ["held", "violated"] and found["spans"][1]["since"] == wrote


def test_without_a_robots_trace_its_own_is_unknown_and_the_store_is_not(home: Path) -> None:
    (home / "bert.jsonl").unlink()
    status, document = audited(home)
    found = by_name(document)
    assert status == 4 and "there is no trace of robot 1" in document["notes"]
    assert found["Near"]["verdict"] == found["Mine"]["verdict"] == "unknown"
    assert found["Mine"]["missing"] == {"mine of robot 1: there is no trace of robot 1": found["Mine"]["unknown"]}
    assert found["Sum"]["verdict"] == "held" and found["Sum"]["unknown"] < found["Sum"]["rounds"], "others saw it"
    motion = found["Motion"]
    assert motion["verdict"] == "unknown" and motion["unknown"] == motion["rounds"] / 2, "bert may have broken it"


def test_an_assumption_is_unknown_while_a_robot_may_have_broken_it(
    home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A robot that came to rest is out of the model; one whose trace is cut off is not."""
    path = home / "bert.jsonl"
    whole = path.read_text()
    path.write_text(whole[: len(whole) // 2])
    status, told = text_of(capsys, home)
    row = next(line for line in told.splitlines() if "assume Motion" in line)
    assert status == 4 and row.split()[0] == "unknown", told
    records = [json.loads(line) for line in whole.splitlines()]
    middle = [r["time"] for r in records if r["kind"] == "round"][4]
    rest = {"kind": "phase", "time": middle, "phase": "stopping", "detail": "landing"}
    kept = [r for r in records if r.get("time", 0.0) <= middle]
    path.write_text("".join(json.dumps(r) + "\n" for r in [*kept, rest]))
    motion = by_name(audited(home)[1])["Motion"]
    assert motion["verdict"] == "held" and motion["unknown"] > 0


def test_what_is_false_without_a_robot_is_violated(tmp_path: Path) -> None:
    home = home_of(tmp_path, WHOLE)
    (home / "bert.jsonl").unlink()
    status, document = audited(home)
    assert status == 3 and by_name(document)["Sum"]["verdict"] == "violated"


LOOPS = """\
Turn:
  pre: turns[pid] == 0 and mine > 0 and pid == 2
  eff:
    for i in range(mine):
      invariant i < 1
      invariant mine >= old(mine)
      turns[pid] += 1
"""


def test_loop_invariants_are_told_by_what_robots_say_of_their_events(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = LINE + LOOPS
    line = text[: text.index("invariant i < 1")].count("\n") + 1
    home = home_of(tmp_path, text, 6.0)
    status, told = text_of(capsys, home)
    assert status == 3 and "in Turn: i < 1" in told
    assert f"loop invariant line {line} is violated (a.koord:{line})" in told
    found = by_name(audited(home)[1])
    broken, kept = found[f"line {line}"], found[f"line {line + 1}"]
    assert (broken["of"], broken["violated"], broken["first"]["robots"]) == ("loop invariant", 1, ["cleo"])
    assert kept["verdict"] == "held" and kept["rounds"] == broken["rounds"] > 1
    assert main(["replay", str(home / "cleo.jsonl"), "--program", str(home / "source/a.koord")]) == 0
    assert "the program violated a loop invariant in 1 event" in capsys.readouterr().err
    edit(home / "cleo.jsonl", lambda record: {**record, "violated": [line + 1]} if "violated" in record else record)
    assert main(["replay", str(home / "cleo.jsonl"), "--program", str(home / "source/a.koord")]) == 3
    said = capsys.readouterr().err
    assert f"the list of false loop invariants is [{line + 1}] in the trace, [{line}] by the program" in said


def jumped(folder: Path, text: str) -> Path:
    """Robot cleo is carried away, which nobody assumes."""
    fleet = watched(folder, text).run(3.0)
    fleet.fleet.robots[2].platform.position = fleet.fleet.robots[2].platform.target = Point(30, 0, 0)
    fleet.run(1.0)
    return saved(folder, fleet, text)


BOXED = """\
using Motion:
  sensors: Point position
  actuators: Point target
  assume position' in Rect(position, target)
initially: forall i in ID: Motion.position[i] in Rect(Point(-9, -9, 0), Point(9, 9, 3))
invariant Fence: forall i in ID: Motion.position[i] in Rect(Point(-9, -9, 0), Point(9, 9, 3)) and \
Motion.target[i] in Rect(Point(-9, -9, 0), Point(9, 9, 3))
Stay:
  pre: pid == 0
  eff: Motion.target = Motion.position
"""


def test_the_assumption_that_broke_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    home = jumped(tmp_path, BOXED)
    found = by_name(audited(home)[1])
    fence, motion = found["Fence"], found["Motion"]
    assert fence["verdict"] == motion["verdict"] == "violated" and motion["first"]["robots"] == ["cleo"]
    assert fence["proof"]["broke"] == [
        {"of": "assume", "name": "Motion", "line": 4, "round": motion["first"]["round"], "robots": ["cleo"]}
    ]
    assert {"port assumption", "initially"} <= {entry["kind"] for entry in fence["proof"]["rests_on"]}
    status, told = text_of(capsys, home, "--prove")
    flat = " ".join(told.split())
    assert status == 3 and "the proof of Fence rests on `assume Motion` (line 4), which broke at " in flat
    assert f"round {motion['first']['round']} from the round's start to its end" in flat and "by robot cleo" in flat


def test_without_a_broken_assumption_it_is_the_tools_mistake_where_it_is_proved(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    home = jumped(tmp_path, BOXED.replace("position' in Rect(position, target)", "position' == position'"))
    found = by_name(audited(home)[1])["Fence"]
    assert found["proof"]["broke"] == [] and "no assumption of its proof broke before" in found["proof"]["says"]
    assert "If `koordgen prove` says PROVED of Fence" in found["proof"]["says"]
    told = by_name(audited(home, "--prove")[1])["Fence"]["proof"]
    assert told["verdict"] == "NOT INDUCTIVE" or told["verdict"] == "FALSIFIED"
    assert "so no proof covers it" in told["says"]


def test_who_had_left_the_model_before_is_named(tmp_path: Path) -> None:
    fleet = watched(tmp_path, WHOLE).run(2.0)
    fleet.fleet.robots[1].agent.end("landing")
    fleet.run(2.0)
    found = by_name(audited(saved(tmp_path, fleet, WHOLE))[1])
    assert (
        found["Sum"]["verdict"] == "violated"
        and "by then bert had been outside of the model" in found["Sum"]["proof"]["says"]
    )


def killed(folder: Path) -> Run:
    """Bert's process is killed, and began anew a second later. It ends when all have told of one round last."""
    run = Run(folder, HOLDS.replace("  assume reached or", "  assume True or"), conditions=conditions(0.05)).run(2.5)
    run.fleet.network._queues.pop(1, None)
    run.fleet.robots[1].wake = 1e9
    run.run(0.5)
    run.boot(1)
    run.run(4.0)
    for _ in range(50):
        if len({last_told(run.files[pid][-1].getvalue()) for pid in range(3)}) == 1:
            return run
        run.run(0.01)
    raise AssertionError("they never tell of the same round last")


def last_told(trace: bytes) -> int:
    """The last round that a trace has."""
    rounds: list[int] = [each["round"] for each in map(json.loads, trace.splitlines()) if each["kind"] == "round"]
    return max(rounds)


def test_a_robot_that_died_and_came_back_is_judged_by_what_it_kept(tmp_path: Path) -> None:
    run = killed(tmp_path)
    folder = run.save()
    status, document = audited(folder / "robots")
    assert status in (0, 4) and document["robots"][1]["lives"] == 2
    found = by_name(document)
    assert {name for name, p in found.items() if p["verdict"] != "held"} == {"Motion"}
    assert found["Motion"]["verdict"] == "unknown", "nobody saw what its body did before it came back"
    assert found["Mine"]["spans"][-1]["outcome"] == "held", "what it kept tells its own variables"
    assert audited(folder)[1]["properties"] == document["properties"], "the merged trace says the same"
    home = tmp_path / "home"
    home.mkdir()
    for pid, name in enumerate(("alice", "bert", "cleo")):
        for k, file in enumerate(run.files[pid]):
            (home / f"{name}-{k}.jsonl").write_bytes(file.getvalue())
    program = folder / "source/app.koord"
    assert audited(home, "--program", program)[1]["properties"] == document["properties"], "a file for each life"
    (home / "bert-0.jsonl").unlink()
    found = by_name(audited(home, "--program", program)[1])
    assert found["Mine"]["verdict"] == "held" and found["Mine"]["unknown"] > 5 > found["Sum"]["unknown"]


def monitor(of: str, name: str, line: int, round_: int, outcome: str, age: int = 0) -> str:
    record = {"kind": "monitor", "time": 9.0, "round": round_, "of": of, "name": name, "line": f"a.koord:{line}",
              "outcome": outcome, "age": age, "why": "", "action": "log"}  # fmt: skip
    return json.dumps(record) + "\n"


def test_what_monitors_said_is_compared(tmp_path: Path) -> None:
    home = home_of(tmp_path, WHOLE)
    found = by_name(audited(home)[1])
    line, since = found["Sum"]["line"], found["Sum"]["first"]["round"]
    near = found["Near"]["line"]
    with (home / "alice.jsonl").open("a") as file:
        file.write(
            monitor("invariant", "Sum", line, 1, "held") + monitor("invariant", "Sum", line, since + 1, "violated")
        )
    with (home / "bert.jsonl").open("a") as file:
        file.write(monitor("invariant", "Near", near, 1, "held") + monitor("invariant", "Near", near, 8, "violated", 3))
        file.write(monitor("invariant", "Near", near, 9, "held"))
    (note,) = audited(home)[1]["notes"]
    assert note.startswith(f"bert reported in round 8 that invariant Near (line {near}) is violated")
    assert "the property held" in note
    edit(home / "alice.jsonl", lambda r: None if r["kind"] == "monitor" and r["outcome"] == "violated" else r)
    notes = audited(home)[1]["notes"]
    assert any(
        n.startswith(f"alice reported that invariant Sum (line {line}) held in rounds {since} to") for n in notes
    )


def test_clocks_that_do_not_go_with_the_rounds_are_noted(home: Path) -> None:
    edit(home / "cleo.jsonl", lambda r: r | {"time": r["time"] + 3} if r.get("round", 0) > 10 else r)
    status, document = audited(home)
    assert status == 0 and any(n.startswith("cleo's clock and its rounds differ by 3.0") for n in document["notes"])


def test_faults_and_contracts_are_findings(home: Path, tmp_path: Path) -> None:
    def broken(record: dict[str, Any]) -> dict[str, Any]:
        if record.get("round") == 5:
            record.update(event="Go", skipped="fault", fault={"file": "a.koord", "line": 21, "reason": "1 / 0"})
        return record

    edit(home / "bert.jsonl", broken)
    status, document = audited(home)
    found = by_name(document)["well-defined"]
    assert status == 3 and found["verdict"] == "violated" and found["first"]["robots"] == ["bert"]
    assert "a.koord:21: 1 / 0" in found["first"]["read"][0] and found["first"]["round"] == 5


CONTRACT = """\
def Mark:
  int count
  Point at
using Motion:
  sensors: Point position
allread: Mark mark[N_SYS]
local: int turn
extern fun next(int turn) -> int:
  requires: turn >= 0
  ensures: result > turn
init: mark[pid] = Mark(0, Motion.position)
Go:
  pre: turn < 9
  eff:
    turn = next(turn)
    mark[pid] = Mark(turn, Motion.position)
invariant Small: forall i in ID: mark[i].count < 9
invariant More: forall i in ID: next(mark[i].count) > mark[i].count or mark[i].count == 5
"""


def test_contracts_and_functions_of_the_users_own_are_judged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    functions = "def next(turn):\n    return turn + (turn != 5)\n"
    folder = Run(tmp_path, CONTRACT, functions=functions).run(4.0).save()
    status, document = audited(folder / "robots")
    found = by_name(document)
    (line,) = [k for k, text in enumerate(CONTRACT.splitlines(), 1) if "ensures" in text]
    requires, ensures = (p for p in document["properties"] if p["of"] == "contract")
    assert status == 3 and (requires["verdict"], ensures["verdict"], ensures["line"]) == ("held", "violated", line)
    assert (
        "which breaks its postcondition (line" in ensures["first"]["read"][0]
        and found["well-defined"]["verdict"] == "held"
    )
    assert found["Small"]["verdict"] == "held" and found["More"]["verdict"] == "no value", "it asks where no result is"
    (folder / "source/app_functions.py").unlink()
    assert main(["audit", str(folder / "robots")]) == 1
    capsys.readouterr()


def test_a_picture_is_drawn(home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert audited(home, "--plot", tmp_path / "a.svg")[0] == 0
    picture = (tmp_path / "a.svg").read_text()
    assert "invariant Near" in picture or len(picture) > 5000
    assert main(["audit", str(home), "--plot", str(tmp_path / "a.nothing")]) == 2
    captured = capsys.readouterr()
    assert "a.nothing: the name of the picture must end in .png, .svg, .pdf" in captured.err and not captured.out
    assert main(["audit", str(home), "--plot", str(tmp_path / "none/a.png")]) == 5
    captured = capsys.readouterr()
    assert "none/a.png: No such file or directory" in captured.err and "verdict" in captured.out, (
        "what was found is told"
    )
