"""A robot's trace has a limit: its files together never take more, and what is kept can be read."""

from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from benchmarks.fixtures.fleet import Fleet, settings
from benchmarks.fixtures.lineform import PROGRAM
from koordgen.runtime.config.settings import BadSettings, load
from koordgen.runtime.ops import doctor
from koordgen.runtime.ops.set_up import open_trace
from koordgen.runtime.program.fleet_program import FleetProgram
from koordgen.runtime.trace.parts import TraceFileParts
from koordgen.runtime.trace.writer import Trace
from tests.disk import small_disk
from tests.runtime.config.test_settings import written


def files(folder: Path) -> list[Path]:
    """The parts in a folder, oldest first."""
    return [
        *sorted(folder.glob("trace-*.jsonl"), key=lambda path: int(path.stem.partition("-")[2])),
        *folder.glob("trace.jsonl"),
    ]


def size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.iterdir())


def records(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_bytes().splitlines()]


def begun(folder: Path, limit: int = 8000, warnings: list[str] | None = None) -> Trace:
    trace = Trace(
        TraceFileParts(folder / "trace.jsonl", "alice", limit), (warnings if warnings is not None else []).append
    )
    trace.header(FleetProgram.alone(PROGRAM, 3), "alice", 0, 3, 0.1)
    return trace


def test_the_limit_is_held_after_every_record(tmp_path: Path) -> None:
    trace = begun(tmp_path)
    for k in range(400):
        trace.log(k / 10, "info", "x" * (k % 90))
        assert size(tmp_path) <= 8000
    trace.close()
    assert size(tmp_path) > 8000 * 3 / 4
    kept = [r["time"] for path in files(tmp_path) for r in records(path) if r["kind"] == "log"]
    assert kept == [k / 10 for k in range(400 - len(kept), 400)], "the newest records, in their order"


def test_what_earlier_starts_left_counts_as_well(tmp_path: Path) -> None:
    for start in range(20):
        trace = begun(tmp_path)
        for k in range(30):
            trace.log(start + k / 100, "info", "x" * 60)
        trace.close()
        assert size(tmp_path) <= 8000
    assert len(files(tmp_path)) > 2
    kept = [r["time"] for path in files(tmp_path) for r in records(path) if r["kind"] == "log"]
    assert kept == sorted(kept) and kept[-1] == 19.29


def test_files_of_others_are_neither_counted_nor_deleted(tmp_path: Path) -> None:
    notes, other = tmp_path / "trace-3.jsonl", tmp_path / "trace-4.jsonl"
    notes.write_text("x" * 9000)
    other.write_text('{"kind":"header","format":"koord-trace/1","robot":"bert"}\n' + "x" * 9000)
    trace = begun(tmp_path)
    for k in range(400):
        trace.log(k / 10, "info", "x" * 60)
    trace.close()
    assert notes.stat().st_size == 9000 and other.stat().st_size > 9000
    assert size(tmp_path) <= 8000 + 9000 + other.stat().st_size


def test_a_part_begins_with_all_that_its_reader_needs(tmp_path: Path) -> None:
    """The state at its beginning is that which the records of the part before led to."""
    fleet = Fleet(n=3)
    for pid in range(3):
        folder = tmp_path / str(pid)
        folder.mkdir()
        fleet.boot(pid, output=TraceFileParts(folder / "trace.jsonl", fleet_name(pid), 12000))
    fleet.run_rounds(120)
    for robot in fleet.robots.values():
        robot.agent._journal._trace.close()
    for pid in range(3):
        parts = files(tmp_path / str(pid))
        assert len(parts) > 4
        whole = [records(path) for path in parts]
        for earlier, later in pairwise(whole):
            header, *_, checkpoint = later[: 1 + [r["kind"] for r in later].index("checkpoint")]
            assert header["kind"] == "header" and header["part"] == earlier[0].get("part", 0) + 1
            rounds = [r for r in earlier if r["kind"] == "round"]
            assert checkpoint["round"] == rounds[-1]["round"]
            written = {name: value for r in rounds for name, value in r.get("locals", {}).items()}
            assert checkpoint["own"]["locals"].items() >= written.items()
            first = next(r for r in later if r["kind"] == "round")
            assert first["round"] == checkpoint["round"] + 1 and set(first["copy"]) == {"x", "last"}
        assert all(any(r["kind"] == "phase" and "mission" in r["detail"] for r in part) for part in whole[1:])
        assert all(any(r["kind"] == "view" for r in part) for part in whole[1:])


def fleet_name(pid: int) -> str:
    return settings(pid, 3).robot


KILLED = """
import os, sys
from pathlib import Path
from koordgen.runtime.trace import parts as trace_parts
from tests.runtime.trace.test_trace_parts import begun
left = int(sys.argv[2])
def die(event, args):
    global left
    if event in ("open", "os.rename", "os.remove") and str(args[0]).startswith(sys.argv[1]):
        left -= 1
        if left < 0:
            os.kill(os.getpid(), 9)
trace = begun(Path(sys.argv[1]))
sys.addaudithook(die)
for k in range(200):
    trace.log(k / 10, "info", "x" * 60)
"""


@pytest.mark.parametrize("after", range(4))
def test_a_kill_amid_a_turn_loses_no_record(tmp_path: Path, after: int) -> None:
    died = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path), str(after + 20)], cwd=Path(__file__).parents[3])
    assert died.returncode == -9
    kept = [r["time"] for path in files(tmp_path) for r in records(path) if r["kind"] == "log"]
    assert kept and kept == [round(kept[0] + k / 10, 1) for k in range(len(kept))], "there is no hole"
    trace = begun(tmp_path)
    trace.log(99.0, "info", "again")
    trace.close()
    assert size(tmp_path) <= 8000 and records(tmp_path / "trace.jsonl")[-1]["time"] == 99.0


def test_a_full_disk_at_a_turn_ends_the_trace_with_one_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    warnings: list[str] = []
    trace = begun(tmp_path, warnings=warnings)
    real = Path.open

    def full(path: Path, mode: str = "r", *rest: Any) -> Any:
        if mode == "wb":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return real(path, mode, *rest)

    monkeypatch.setattr(Path, "open", full)
    for k in range(100):
        trace.log(k / 10, "info", "x" * 60)
    assert warnings == ["the trace ends here: No space left on device"] and not trace.open


def test_a_part_that_was_taken_away_is_not_missed(tmp_path: Path) -> None:
    warnings: list[str] = []
    trace = begun(tmp_path, warnings=warnings)
    for k in range(400):
        trace.log(k / 10, "info", "x" * 60)
        if k % 37 == 0:
            for path in files(tmp_path):
                path.unlink()
    trace.close()
    assert not warnings and size(tmp_path) <= 8000


def test_an_agent_writes_parts_and_a_device_has_none(tmp_path: Path) -> None:
    path = tmp_path / "trace.jsonl"
    for start in range(3):
        trace = open_trace(settings(0, 3, trace=str(path), trace_limit=1.0), print)
        trace.header(FleetProgram.alone(PROGRAM, 3), "alice", 0, 3, 0.1)
        for _ in range(300):
            trace.log(start, "info", "x" * 3000)
        trace.close()
        assert size(tmp_path) <= 1_000_000
    assert len(files(tmp_path)) >= 7
    device = open_trace(settings(0, 3, trace="/dev/null", trace_limit=1.0), print)
    for _ in range(500):
        device.log(0.0, "info", "x" * 3000)
    device.close()
    assert Path("/dev/null").is_char_device() and not Path("/dev/null-1").exists()


def test_a_disk_that_is_full_ends_the_trace_once_and_what_stands_is_read(tmp_path: Path) -> None:
    warnings: list[str] = []
    with small_disk(tmp_path / "disk", "200k") as folder:
        trace = begun(folder, 8_000_000, warnings)
        for k in range(1000):
            trace.log(k / 10, "info", "x" * 900)
        lines = (folder / "trace.jsonl").read_bytes().split(b"\n")
    assert warnings == ["the trace ends here: No space left on device"] and not trace.open
    kept = [json.loads(line) for line in lines[:-1]]
    assert len(kept) > 100 and kept[-1]["time"] == (len(kept) - 2) / 10


def test_doctor_says_whether_there_is_room_for_the_trace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "trace-1.jsonl").write_bytes(bytes(3_000_000))
    free = SimpleNamespace(free=10_000_000)
    monkeypatch.setattr(shutil, "disk_usage", lambda place: free)
    assert doctor._trace(tmp_path / "trace.jsonl", 12.0).state == "ok"
    little, unlimited = doctor._trace(tmp_path / "trace.jsonl", 14.0), doctor._trace(tmp_path / "trace.jsonl", None)
    assert (little.state, little.wanted, unlimited.state) == ("warn", "11 MB free", "warn")


@pytest.mark.parametrize("limit", [0.0, -1.0, 0.9, 1e7])
def test_a_limit_out_of_range_is_refused(tmp_path: Path, limit: float) -> None:
    with pytest.raises(BadSettings, match="trace_limit"):
        load(written(tmp_path, ("trace_limit",), limit))
