"""Audit and replay of traces in parts: for the rounds that are kept, the same result as for the whole trace."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from koordgen.cli import main
from tests.verify.audit.fleets import PROGRAM, audited, conditions
from tests.verify.audit.test_partly import outcomes
from tests.verify.replay.parts import Kept
from tests.verify.replay.runs import Run
from tests.verify.replay.test_replay import ALL, FUNCTIONS


def flown(run: Run, seed: int) -> Path:
    """One of the robots may die and come back, or come to rest; the same for the same seed."""
    what = ("nothing", "dies", "rests")[seed % 3]
    run.run(3.0)
    if what == "dies":
        run.fleet.network._queues.pop(1, None)
        run.fleet.robots[1].wake = 1e9
        run.run(0.7)
        run.boot(1)
    elif what == "rests":
        run.fleet.robots[1].agent.end("landing")
    run.run(3.0)
    return run.save()


def first_round(folder: Path) -> int:
    """Return the first round that a robot's parts record; 0: `init`."""
    lines = [json.loads(line) for path in folder.glob("*.jsonl") for line in path.read_bytes().splitlines()]
    return min(int(line.get("round", 0)) for line in lines if line["kind"] in ("init", "round"))


def first_copy(folder: Path, since: int) -> int:
    """The first round from `since` on for which a robot's parts tell the shared variables: it was current."""
    lines = [json.loads(line) for path in folder.glob("*.jsonl") for line in path.read_bytes().splitlines()]
    copies = [int(line["round"]) for line in lines if line["kind"] == "round" and "copy" in line]
    return min((copied for copied in copies if copied >= since), default=10**9)


@pytest.mark.parametrize("seed", range(3))
def test_an_audit_says_of_the_kept_rounds_what_it_says_of_the_whole(tmp_path: Path, seed: int) -> None:
    options: dict[str, Any] = {"seed": seed, "conditions": conditions(0.1)}
    whole = flown(Run(tmp_path / "whole", PROGRAM, **options), seed)
    kept = flown(Kept(tmp_path / "kept", PROGRAM, 10000, **options), seed)
    parts = flown(Kept(tmp_path / "parts", PROGRAM, 40000, **options), seed)
    program = whole / "source/app.koord"
    status, document = audited(whole / "robots", "--program", program)
    assert len(list(parts.rglob("*-1.jsonl"))) == 3, "each has several parts"
    same_status, same = audited(parts / "robots", "--program", program)
    assert (same_status, same["properties"], same["first"]) == (status, document["properties"], 0)
    less_status, less = audited(kept / "robots", "--program", program)
    known = [first_round(kept / "robots" / robot["name"]) for robot in less["robots"]]
    assert max(known) > 20 and less["first"] == min(known) > 0 and less_status in (3, 4)
    assert {robot["lives"] for robot in less["robots"]} <= {1, 2}
    wanted = outcomes(document)
    complete = min(first_copy(kept / "robots" / robot["name"], max(known)) for robot in less["robots"])
    assert complete < less["rounds"] - 3
    for key, outcome in outcomes(less).items():
        if key[3] < min(known):
            assert outcome == "unknown"
        elif key[3] >= complete and key[3] < less["rounds"]:
            assert outcome == wanted[key]
        else:
            assert outcome in ("unknown", wanted[key])
    for name, since in zip(("alice", "bert", "cleo"), known, strict=True):
        assert f"{name}'s trace begins in round {since}:" in "\n".join(less["notes"])


def test_an_audit_says_from_which_round_on_the_run_is_known(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = "local: int n\nGo:\n  pre: True\n  eff: n += 1\ninvariant Few: forall i in ID: n[i] >= 0\n"
    kept = Kept(tmp_path, text, 6000).run(8.0).save() / "robots"
    since = min(first_round(kept / name) for name in ("alice", "bert", "cleo"))
    assert main(["audit", str(kept), "--program", str(tmp_path / "source/app.koord")]) == 4
    told = capsys.readouterr().out
    assert f"unknown before round {since}" in told.splitlines()[0]
    few = next(line for line in told.splitlines() if "invariant Few" in line).split()
    assert few[0] == "held" and few[-1] == str(since), "its unknown rounds are counted"


def replayed(path: Path, run: Run, capsys: pytest.CaptureFixture[str]) -> str:
    assert main(["replay", str(path), "--program", str(run.folder / "source/app.koord"), "--param", "most=3"]) == 0
    told = capsys.readouterr()
    return told.out + told.err


def test_parts_are_replayed_as_one_trace(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options: dict[str, Any] = {"params": {"most": 3}, "functions": FUNCTIONS}
    whole = Run(tmp_path / "whole", ALL, **options).run(6.0)
    parts = Kept(tmp_path / "parts", ALL, 100_000, **options).run(6.0)
    kept = Kept(tmp_path / "kept", ALL, 12_000, **options).run(6.0)
    for run in (whole, parts, kept):
        run.save()
    for name in ("alice", "bert", "cleo"):
        place = Path("robots") / name / "trace.jsonl"
        told = replayed(whole.folder / place, whole, capsys)
        again = replayed(parts.folder / place, parts, capsys)
        assert again.partition(": ")[2] == told.partition(": ")[2], "as many rounds and events"
        since = first_round(kept.folder / place.parent)
        less = replayed(kept.folder / place.parent, kept, capsys)
        assert since > 5 and f"note: rounds before {since} are unknown" in less


def test_a_part_that_is_not_what_the_part_before_led_to_is_a_difference(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = "local: int n\nGo:\n  pre: True\n  eff: n += 1\n"
    folder = Kept(tmp_path, text, 40_000).run(6.0).save() / "robots/bert"
    part = max(folder.glob("trace-*.jsonl"))
    lines = part.read_text().splitlines(keepends=True)
    number = next(k for k, line in enumerate(lines) if '"kind":"checkpoint"' in line)
    record = json.loads(lines[number])
    record["own"]["locals"]["n"] += 1
    lines[number] = json.dumps(record) + "\n"
    part.write_text("".join(lines))
    assert main(["replay", str(folder / "trace.jsonl")]) == 3
    assert f"{part}:{number + 1}: round " in capsys.readouterr().err


@pytest.mark.parametrize("ends", ["without the current part", "with an empty part", "with half a header"])
def test_a_robot_that_was_killed_as_a_part_began_is_read(
    tmp_path: Path, ends: str, capsys: pytest.CaptureFixture[str]
) -> None:
    text = "local: int n\nGo:\n  pre: True\n  eff: n += 1\ninvariant Few: forall i in ID: n[i] >= 0\n"
    folder = Kept(tmp_path, text, 40_000).run(6.0).save() / "robots"
    current = folder / "bert/trace.jsonl"
    header = current.read_bytes().splitlines()[0]
    number = max(int(path.stem.partition("-")[2]) for path in current.parent.glob("trace-*")) + 1
    current.rename(current.with_stem(f"trace-{number}"))
    if ends != "without the current part":
        current.write_bytes(b"" if ends == "with an empty part" else header[: len(header) // 2])
    for path in (current, current.parent):
        assert main(["replay", str(path)]) == 0, capsys.readouterr().err
    program = tmp_path / "source/app.koord"
    assert audited(folder, "--program", program)[0] in (0, 4)
    named = [folder / name / "trace.jsonl" for name in ("alice", "bert", "cleo")]
    status, document = audited(*named, "--program", program)
    assert status in (0, 4) and len(document["robots"][1]["files"]) == number


def test_earlier_missions_and_versions_in_a_robots_folder_are_left_aside(tmp_path: Path) -> None:
    text = "local: int n\nGo:\n  pre: True\n  eff: n += 1\ninvariant Few: forall i in ID: n[i] >= 0\n"
    home = tmp_path / "robots"
    Kept(tmp_path / "old", text + "invariant Old: True\n", 40_000, home).run(2.0).save()
    Kept(tmp_path / "first", text, 40_000, home, seed=2).run(2.0).save()
    last = Kept(tmp_path / "last", text, 40_000, home, seed=3).run(3.0)
    status, document = audited(home, "--program", last.save() / "source/app.koord")
    rounds = max(robot.records[-1].round for robot in last.fleet.robots.values())
    assert status in (0, 4) and document["rounds"] == rounds > 10
    notes = "\n".join(document["notes"])
    assert "is of an earlier version of the program, and is ignored" in notes
    assert "alice's part in mission" in notes
