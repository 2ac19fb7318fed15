"""Comparison of an outer robot with its squad: it read what the squad had, and the squad got its commands."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from koordgen.cli import main
from tests.squads.disturbances import KILLS, OTHERS, disturbed
from tests.squads.levels import WAVE, Levels
from tests.squads.saved import save
from tests.squads.test_hosts import LINE
from tests.verify.replay.test_squads import Record, changed, flown, run

__all__ = ["flown", "run"]


def is_clean(folder: Path, capsys: pytest.CaptureFixture[str]) -> int:
    """Replay and audit both levels of a run without a difference. Return the number of compared readings."""
    for fleet in (folder, folder / "alice", folder / "bert"):
        capsys.readouterr()
        assert main(["audit", str(fleet)]) in (0, 4), capsys.readouterr()
        assert main(["replay", str(fleet)]) == 0, capsys.readouterr()
    assert main(["replay", str(folder)]) == 0
    text = capsys.readouterr().out
    found = re.findall(r"(\d+) readings and (\d+) commands of \w+(?:, (\d+) not)?", text)
    assert len(found) == 2 and all(int(commands) > 0 for _, commands, _ in found), text
    readings, unchecked = sum(int(n) for n, _, _ in found), sum(int(n or 0) for _, _, n in found)
    assert unchecked <= readings / 4, text
    return readings


def test_traces_of_both_levels_agree_although_hosts_die(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert is_clean(save(tmp_path, disturbed(1, 1, KILLS, WAVE), WAVE), capsys) > 15


@pytest.mark.slow
@pytest.mark.parametrize("kinds", [KILLS, OTHERS], ids=["kills", "others"])
@pytest.mark.parametrize("seed", range(2, 12))
def test_traces_of_both_levels_agree_although_many_robots_are_disturbed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], seed: int, kinds: Sequence[str]
) -> None:
    assert is_clean(save(tmp_path, disturbed(seed, 5, kinds, WAVE), WAVE), capsys) > 40


def of_bert(round_: int, group: str, name: str, value: Any) -> Callable[[Record], bool]:
    """Return a change of a value in the record of the outer robot bert of the first round from `round_` on with it."""

    def change(record: Record) -> bool:
        if record["kind"] != "round" or record["pid"] != 1 or record["round"] < round_ or not record.get("event"):
            return False
        found = name in record.get(group, {})
        if found:
            record[group][name] = value
        return found

    return change


def test_a_clean_run_is_compared(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["audit", str(run), "--format", "json"]) == 0
    (squad,) = json.loads(capsys.readouterr().out)["squads"]
    assert squad["robot"] == "bert" and squad["readings"] >= 12 and squad["commands"] >= 3
    assert squad["unchecked"] == 0 and squad["differences"] == []


@pytest.mark.parametrize(
    ("group", "name", "value", "what"),
    [
        ("sensors", "Motion.position", [1.0, 2.0, 3.0], "the squad did not have this value in its rounds"),
        ("actuators", "Motion.target", [1.0, 2.0, 3.0], "the command is not in goal once the next outer event"),
    ],
)
def test_a_changed_value_of_the_outer_robot_is_reported_with_both_places(
    run: Path, capsys: pytest.CaptureFixture[str], group: str, name: str, value: Any, what: str
) -> None:
    line = changed(run / "trace.jsonl", of_bert(4, group, name, value))
    assert main(["audit", str(run)]) == 3
    text = capsys.readouterr().out
    place = re.escape(f"{run / 'trace.jsonl'}:{line}: ")
    inner = re.escape(str(run / "bert" / "trace.jsonl"))
    found = rf"{place}round \d+, robot bert: {name} is \[1.0, 2.0, 3.0\]; in round \d+ of the squad \({inner}:\d+\)"
    assert re.search(found, text) and what in text, text
    assert main(["replay", str(run)]) == 3
    assert what in capsys.readouterr().err


def test_what_an_outer_robot_read_without_an_event_is_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    levels = Levels(LINE, [3, 0, 0])
    levels.run_rounds(6)
    folder = save(tmp_path, levels, LINE)
    assert main(["audit", str(folder)]) == 0
    text = capsys.readouterr().out
    assert re.search(r": [67] readings and 0 commands of alice", text) and "no differences from the squad" in text

    def moves(record: Record) -> bool:
        found = record["kind"] == "round" and record["pid"] == 0 and record["round"] == 3
        if found:
            record["sensors"]["Motion.position"] = [1.0, 2.0, 3.0]
        return bool(found)

    changed(folder / "trace.jsonl", moves)
    assert main(["audit", str(folder)]) == 3
    assert "round 3, robot alice: Motion.position is [1.0, 2.0, 3.0]" in capsys.readouterr().out


def test_a_sensor_that_no_command_cleared_is_not_true_before_it_is_reached(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def reaches(record: Record) -> bool:
        sensors = record.get("sensors", {}) if record["kind"] == "round" and record["pid"] == 1 else {}
        found = sensors.get("Motion.reached") is False and record["round"] > 4 and bool(record["event"])
        if found:
            sensors["Motion.reached"] = True
        return found

    changed(run / "trace.jsonl", reaches)
    assert main(["audit", str(run)]) == 3
    assert "Motion.reached is true" in capsys.readouterr().out


def test_a_write_of_the_host_in_all_records_of_the_squad_is_still_no_command(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The squad's own trace is consistent, but the outer robot commanded something else."""
    trace = run / "bert" / "trace.jsonl"
    written = [r["shared"]["goal"] for r in map(json.loads, trace.read_text().splitlines()) if _writes_goal(r)]
    old, new = json.dumps(written[-1]), json.dumps([5.0, 4.0, 3.5])
    text = "\n".join(line.replace(f'"goal":{old}', f'"goal":{new}') for line in _compact(trace))
    trace.write_text(f"{text}\n")
    assert main(["audit", str(run)]) == 3
    found = capsys.readouterr().out
    assert "the host, wrote it to goal, which is no command of the outer robot" in found, found


def _writes_goal(record: Record) -> bool:
    return record["kind"] == "round" and record.get("event") == "Write" and "goal" in record["shared"]


def _compact(trace: Path) -> list[str]:
    lines = [json.dumps(json.loads(line)) for line in trace.read_text().splitlines()]
    return [line.replace('"goal": [', '"goal":[') for line in lines]


def test_a_squad_whose_programs_are_missing_is_not_compared(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.rmtree(run / "bert" / "source")
    assert main(["replay", str(run)]) == 0
    assert "squad bert was not compared: there is no folder source/ beside" in capsys.readouterr().out
