"""`koordgen explore`: messages about bad files and bounds."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from koordgen.cli import main

EXAMPLES = Path(__file__).parents[3] / "examples"
EXTERN = """
extern fun half(int n) -> int:
  ensures: result <= n
local: int n = 4
Halve:
  pre: n > 0
  eff: n = half(n)
Done:
  pre: n == 0
  eff: stop
"""
DOOR = """
using Door:
  sensors: int angle
  assume angle' >= 0 and angle' <= 2
local: bool seen
See:
  pre: Door.angle == 2 and not seen
  eff: seen = True
Stop:
  pre: seen
  eff: stop
Slam:
  pre: Door.angle > 90
  eff: seen = False
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "extern.koord").write_text(EXTERN)
    (tmp_path / "door.koord").write_text(DOOR)
    return tmp_path


def told(capsys: pytest.CaptureFixture[str], *args: str) -> tuple[int, str]:
    status = main(["explore", *args])
    shown = capsys.readouterr()
    return status, " ".join((shown.out + shown.err).split())


def test_a_bound_tells_how_far_it_came(capsys: pytest.CaptureFixture[str]) -> None:
    election = str(EXAMPLES / "election/election.koord")
    status, text = told(capsys, election, "--robots", "5", "--states", "30", "--no-symmetry")
    assert status == 4 and "INCONCLUSIVE explored to depth 0;" in text
    assert "ended by: the limit of 30 states; no violation found so far" in text


def test_a_port_that_needs_values_is_named(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, text = told(capsys, str(folder / "door.koord"))
    assert status == 2 and "Door.angle needs values, a finite number of them" in text
    assert "`koordgen docs explore`" in text


@pytest.mark.parametrize("text, place", [
    ("Door.angle: [0, 1.5]\n", "env.yaml:1:17: error[F004]"),
    ("Door.angle: {lo: 0, hi: 2}\nMotion.position: [[0, 0, 0]]\n", "env.yaml:2:1: error[F002]"),
    ("Door.angle: {lo: 0, hi: 2}\nparams: {wide: 2}\n", "env.yaml:2:10: error[F002]"),
    ("Door.angle: {lo: 3, hi: 2}\n", "env.yaml:1:13: error[F005]"),
    ("", "env.yaml:1:1: error[F001]"),
])  # fmt: skip
def test_a_wrong_file_is_told_with_its_place(
    folder: Path, capsys: pytest.CaptureFixture[str], text: str, place: str
) -> None:
    (folder / "env.yaml").write_text(text)
    status, shown = told(capsys, str(folder / "door.koord"), "--env", str(folder / "env.yaml"))
    assert status == 1 and place in shown


def test_a_file_that_is_not_there(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, text = told(capsys, str(folder / "door.koord"), "--env", str(folder / "none.yaml"))
    assert status == 1 and "none.yaml" in text and "F100" in text


def test_events_that_are_never_enabled_are_told(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "env.yaml").write_text("Door.angle: {lo: 0, hi: 2}\n")
    status, text = told(capsys, str(folder / "door.koord"), "--env", str(folder / "env.yaml"))
    assert status == 0 and "never enabled: Slam (line 12)" in text


def test_assumptions_that_leave_no_value_are_no_proof(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "env.yaml").write_text("Door.angle: [3, 4]\n")  # the module assumes 0 to 2
    args = (str(folder / "door.koord"), "--env", str(folder / "env.yaml"))
    status, text = told(capsys, *args, "--no-deadlock")
    assert status == 4 and "the assumptions leave sensors no value" in text
    (folder / "door.koord").write_text(DOOR + "initially: forall i in ID: Door.angle[i] < 0\n")
    status, text = told(capsys, *args)
    assert status == 4 and "no state satisfies `initially`" in text


@pytest.mark.parametrize("body, status, wanted", [
    (None, 1, "extern_functions.py, the file with the extern functions, does not exist"),
    ("def half(n):\n    return n +\n", 1, "extern_functions.py cannot be imported: SyntaxError"),
    ("import nowhere_at_all\n", 1, "cannot be imported: ModuleNotFoundError"),
    ("def other(n):\n    return n\n", 1, "extern_functions.py lacks half, which the program declares as extern"),
    ("def half(n):\n    raise OSError('gone')\n", 3, "Halve of robot 0 has no result: half raised OSError: gone"),
    ("def half(n):\n    return n + 1\n", 3, "an event without a result at the beginning"),
    ("def half(n):\n    return 'two'\n", 3, "an event without a result at the beginning"),
    ("def half(n):\n    return n // 2\n", 0, "HOLDS"),
])  # fmt: skip
def test_extern_functions(
    folder: Path, capsys: pytest.CaptureFixture[str], body: str | None, status: int, wanted: str
) -> None:
    if body is not None:
        (folder / "extern_functions.py").write_text(body)
    found, text = told(capsys, str(folder / "extern.koord"), "--robots", "2")
    assert (found, wanted in text) == (status, True), text


def test_a_fleet_gives_params_and_how_many(capsys: pytest.CaptureFixture[str]) -> None:
    folder = EXAMPLES / "patrol"
    args = (str(folder / "patrol.koord"), "--fleet", str(folder / "fleet.yaml"), "--format", "json", "--rounds", "1")
    assert main(["explore", *args]) == 4
    assert json.loads(capsys.readouterr().out)["robots"] == 3
    assert main(["explore", *args, "--robots", "2"]) == 4
    assert json.loads(capsys.readouterr().out)["robots"] == 2
    delivery = EXAMPLES / "delivery"
    files = ("--fleet", str(delivery / "fleet.yaml"), "--env", str(delivery / "explore.yaml"))
    status, text = told(capsys, str(delivery / "delivery.koord"), *files, "--rounds", "1")
    assert status == 4 and "delivery.koord, 2 robots" in text


def test_the_command_line_has_the_last_word_on_params(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    env = folder / "env.yaml"
    env.write_text("params: {salt: 2}\n")
    election = str(EXAMPLES / "election/election.koord")
    trace = folder / "none.jsonl"
    assert main(["explore", election, "--env", str(env), "--param", "salt=x", "--trace", str(trace)]) == 2
    assert "salt" in capsys.readouterr().err
    assert main(["explore", election, "--env", str(env), "--param", "salt=3"]) == 0


def test_a_file_of_functions_with_another_ending(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = folder / "functions.txt"
    file.write_bytes(b"\x00\xff\xfe")
    status, said = told(capsys, str(folder / "extern.koord"), "--functions", str(file))
    assert status == 1 and "functions.txt cannot be imported: " in said


def test_a_trace_that_cannot_be_written_costs_nothing_of_what_was_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lost = tmp_path / "lost.koord"
    lost.write_text((EXAMPLES / "atomicsum/atomicsum.koord").read_text().replace("  eff: atomic:", "  eff:", 1))
    assert main(["explore", str(lost), "--robots", "2", "--trace", str(tmp_path / "none/t.jsonl")]) == 5
    captured = capsys.readouterr()
    assert "Counted is violated after 1 round" in captured.out and "none/t.jsonl: No such file" in captured.err


@pytest.mark.parametrize("robots", ["0", "129", "two"])
def test_fleets_of_no_size_that_robots_have(robots: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main(["explore", str(EXAMPLES / "election/election.koord"), "--robots", robots])
    said = capsys.readouterr().err
    assert left.value.code == 2 and f"expected a whole number from 1 to 128, not {robots}" in said
