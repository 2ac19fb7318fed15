"""Replay of a squad: the writes of the application that hosts the outer robot are given, and are checked."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from koordgen.cli import main
from tests.squads.levels import WAVE, Levels
from tests.squads.saved import save

Record = dict[str, Any]


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with the squad bert and two ordinary robots."""
    levels = Levels(WAVE, [0, 3, 0])
    levels.run_rounds(12)
    return save(tmp_path_factory.mktemp("levels"), levels, WAVE)


@pytest.fixture
def run(flown: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(flown, tmp_path / "run"))


def changed(trace: Path, change: Callable[[Record], bool]) -> int:
    """Change the first record that `change` accepts. Return its line."""
    lines = trace.read_text().splitlines()
    for number, line in enumerate(lines):
        record = json.loads(line)
        if change(record):
            lines[number] = json.dumps(record)
            trace.write_text("\n".join(lines) + "\n")
            return number + 1
    raise AssertionError("no record has such a value")


def event_of(application: str, event: str, write: Callable[[Record], Any]) -> Callable[[Record], bool]:
    """Return a change of a record of an event. `write` changes it, and returns False if it needs another record."""

    def change(record: Record) -> bool:
        if record.get("application") != application or record.get("event") != event or record["round"] < 5:
            return False
        return write(record) is not False

    return change


def moves_goal(record: Record) -> Any:
    return "goal" in record["shared"] and record["shared"].update(goal=[1.0, 2.0, 3.0])


def other_copy(record: Record) -> Any:
    return "goal" in record.get("copy", {}) and record["copy"].update(goal=[1.0, 2.0, 3.0])


def test_a_squads_trace_has_no_differences(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(run / "bert")]) == 0
    assert "no differences from the programs" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "application", "what"),
    [
        (event_of("outer", "Write", moves_goal), "triangle", "copy of goal is"),
        (event_of("outer", "Write", lambda r: r["shared"].update(corner=[0.0, 0.0, 0.0])), "outer", "corner is"),
        (event_of("outer", "Write", lambda r: r.update(event="Other")), "outer", "the event is Other"),
        (event_of("outer", "Write", lambda r: r["shared"].update({"(record)": ["AAAA"]})), "outer", "copy of (record)"),
        (event_of("triangle", "Keep", other_copy), "triangle", "copy of goal is"),
    ],
)
def test_a_changed_value_of_a_squad_is_reported(
    run: Path, capsys: pytest.CaptureFixture[str], change: Callable[[Record], bool], application: str, what: str
) -> None:
    changed(run / "bert" / "trace.jsonl", change)
    assert main(["replay", str(run / "bert")]) == 3
    text = capsys.readouterr().err
    assert any(f"application {application}: {what}" in line for line in text.splitlines()), text


def test_a_claim_commands_nothing(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def claims(record: Record) -> bool:
        found = record.get("event") == "Claim"
        return found and record["shared"].update(goal=[0.0, 0.0, 0.0]) is None

    line = changed(run / "bert" / "trace.jsonl", claims)
    assert main(["replay", str(run / "bert")]) == 3
    assert f"trace.jsonl:{line}: round 1, robot alice, application outer: goal is" in capsys.readouterr().err


def test_a_header_that_commands_other_variables_is_refused(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def commands(record: Record) -> bool:
        record["composition"][1]["variables"]["corner"] = "triangle.corner"
        return True

    changed(run / "bert" / "trace.jsonl", commands)
    assert main(["replay", str(run / "bert")]) == 1
    assert "triangle takes no commands by corner" in capsys.readouterr().err
