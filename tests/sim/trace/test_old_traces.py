"""Runs that an earlier koordgen left, format koord-trace/1: all that reads traces reads them, and `export` renews them.

The traces stand in tests/verify/replay/old, as koordgen wrote them before koord-trace/2 (of poses in `run` each tenth).
Only their program hashes are those of today's encoding.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from koordgen.cli import main
from koordgen.runtime.trace.schema import FORMAT, OLD_FORMAT, BadTrace
from koordgen.verify.follow.read import read as read_counterexample
from targets.sim.base.folder import RunFolder
from targets.sim.trace.collected import merge
from targets.sim.trace.files import read
from tests.disk import small_disk
from tests.sim.follow.following import fleet, follow
from tests.verify.replay.test_schema import OLD, OLD_TRACES


@pytest.fixture
def old(tmp_path: Path) -> Path:
    shutil.copytree(OLD, tmp_path / "old")
    return tmp_path / "old"


def formats(path: Path) -> str:
    return str(json.loads(path.read_bytes().splitlines()[0])["format"])


def test_report_tables_and_show_are_those_of_the_renewed_trace(old: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = old / "run"
    assert main(["export", str(run), "--to", FORMAT]) == 0
    new = run / "trace.koord-trace-2"
    assert capsys.readouterr().out == f"{new}\n" and (formats(run / "trace.jsonl"), formats(new)) == (
        OLD_FORMAT,
        FORMAT,
    )
    made = []
    for trace in (run / "trace.jsonl", new):
        assert main(["report", str(trace), "-o", str(old / "page.html")]) == 0
        assert main(["export", str(trace), "--to", "csv", "-o", str(old / "csv")]) == 0
        assert main(["export", str(trace), "--to", "mcap", "-o", str(old / "mcap")]) == 0
        assert main(["show", str(trace), "--at", "1"]) == 0
        tables = {path.name: path.read_bytes() for path in (old / "csv").iterdir()}
        shown = capsys.readouterr().out.replace(str(trace), "")
        made.append(((old / "page.html").read_bytes(), tables, (old / "mcap").read_bytes(), shown))
    assert made[0] == made[1]
    assert len(made[0][1]["rounds.csv"].splitlines()) > 200 and "alice" in made[0][3]


def test_old_records_name_the_application(old: Path) -> None:
    header, records = read(old / "run/trace.jsonl")
    assert (header.format, header.app, header.applications) == (FORMAT, "lineform", ("lineform",))
    named = {type(each).__name__: getattr(each, "application", None) for each in records}
    assert (named["Round"], named["InitRecord"], named["PoseRecord"]) == ("lineform", "lineform", None)


def test_replay_and_audit_take_old_and_renewed_traces(old: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = old / "run"
    for trace in (run / "trace.jsonl", run / "robots/alice/trace.jsonl"):
        assert main(["export", str(trace), "--to", FORMAT]) == 0
        found = []
        for each in (trace, trace.with_name("trace.koord-trace-2")):
            capsys.readouterr()
            assert main(["replay", str(each)]) == 0
            replayed = capsys.readouterr().out.replace(str(each), "")
            assert main(["audit", str(each), "--program", str(run / "source/lineform.koord")]) in (0, 4)
            found.append((replayed, capsys.readouterr().out.replace(each.name, "")))
        assert found[0] == found[1] and "no differences from the program" in found[0][0]


def test_old_parts_of_a_trace_are_one(old: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(old / "parts/trace.jsonl")]) == 0
    assert "1 robot, 16 rounds, 8 events: no differences from the program" in capsys.readouterr().out
    assert main(["audit", str(old / "parts"), "--format", "json"]) == 4, "the other robot's trace is not there"


def test_old_traces_of_robots_are_merged_into_a_new_one(old: Path) -> None:
    names = ("alice", "bert")
    robots = [{"name": name, "pid": pid, "target": "quad"} for pid, name in enumerate(names)]
    header = {"format": FORMAT, "app": "lineform", "program_hash": "0", "delta": 0.1, "seed": 0, "robots": robots}
    traces = [[old / "run/robots" / name / "trace.jsonl"] for name in names]
    with traces[1][0].open("ab") as file:
        file.write(b'{"kind":"round","round":9,"ski\xffped":null,"time":18.0}\nbroken\n')
    merge(old / "whole.jsonl", {"kind": "header", **header}, traces, 2.0)
    records = [json.loads(line) for line in (old / "whole.jsonl").read_bytes().splitlines()]
    events = [each for each in records if each["kind"] in ("init", "round")]
    assert len(events) > 80 and {each["application"] for each in events} == {"lineform"}
    poses = [each for each in records if each["kind"] == "pose"]
    assert len(poses) == len(events) and not any("application" in each for each in poses)


def test_agents_follow_an_old_counterexample(old: Path) -> None:
    trace = old / "counterexample/trace.jsonl"
    assert main(["export", str(trace), "--to", FORMAT]) == 0
    new = trace.with_name("trace.koord-trace-2")
    assert read_counterexample(trace) == read_counterexample(new)._replace(path=trace)
    done = follow(old / "counterexample/app.koord", fleet(old, 2), trace)
    assert done.status == 3 and "as in the trace" in done.said
    assert formats(done.folder / "trace.jsonl") == FORMAT
    assert main(["report", str(trace), "-o", str(old / "page.html")]) == 0


@pytest.mark.parametrize("path", OLD_TRACES, ids=lambda path: str(path.relative_to(OLD)))
def test_every_old_trace_can_be_renewed(path: Path, tmp_path: Path) -> None:
    assert main(["export", str(path), "--to", FORMAT, "-o", str(tmp_path / "new")]) == 0
    assert formats(tmp_path / "new") == FORMAT


def test_a_trace_of_the_present_format_is_copied_and_told(old: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(old / "run"), "--to", FORMAT, "-o", str(old / "a")]) == 0
    capsys.readouterr()
    assert main(["export", str(old / "a"), "--to", FORMAT, "-o", str(old / "b")]) == 0
    told = capsys.readouterr()
    assert told.err == f"note: {old / 'a'} already has the format koord-trace/2; the new file is a copy\n"
    assert told.out == f"{old / 'b'}\n" and (old / "a").read_bytes() == (old / "b").read_bytes()
    assert main(["export", str(old / "b"), "--to", FORMAT, "-o", str(old / "b")]) == 0, "onto itself"
    assert (old / "a").read_bytes() == (old / "b").read_bytes()


@pytest.mark.parametrize(
    "command", ["report", "show", "replay", "audit", "export --to csv", "export --to koord-trace/2"]
)
def test_a_later_format_is_refused_by_its_name(old: Path, command: str, capsys: pytest.CaptureFixture[str]) -> None:
    for path in (old / "run/trace.jsonl", old / "run/robots/bert/trace.jsonl"):
        path.write_bytes(path.read_bytes().replace(b"koord-trace/1", b"koord-trace/3", 1))
        word, *more = command.split()
        assert main([word, str(path), *more]) == 1
        told = capsys.readouterr().err
        assert str(path) in told
        assert "its format is koord-trace/3; this koordgen reads koord-trace/1 and koord-trace/2" in told
    with pytest.raises(BadTrace, match="its format is koord-trace/3"):
        read_counterexample(old / "run/trace.jsonl")


@pytest.mark.parametrize(
    ("data", "place", "said"),
    [
        (b"", "", "no header of format koord-trace/2 or koord-trace/1; the file is empty"),
        (b'{"kind":"end","t":1.0,"why":"x"}\n', "", "no header of format koord-trace/2 or koord-trace/1"),
        (b"\xff\x00nonsense\n", ":1", "JSON is malformed"),
        (b'{"kind":"header","format":"koord-trace/1","app":"a"}\n', ":1", "missing required field"),
    ],
)
def test_what_is_no_trace_is_refused(
    tmp_path: Path, data: bytes, place: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "x").write_bytes(data)
    assert main(["export", str(tmp_path / "x"), "--to", FORMAT]) == 1
    told = capsys.readouterr().err
    assert f"{tmp_path / 'x'}{place}: " in told and said in told
    assert [path.name for path in tmp_path.iterdir()] == ["x"]


def test_a_damaged_trace_is_told_with_its_place(old: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = old / "run/trace.jsonl"
    whole = path.read_bytes()
    lines = whole.splitlines(keepends=True)
    for data, number, said in (
        (whole[:-9], len(lines), "the file is cut off there"),
        (b"".join([*lines[:7], b'{"kind":"round","t":1,"pid":0,"round":"x"}\n', *lines[7:]]), 8, "Expected `int`"),
        (b"".join([*lines[:7], b"[" * 100_000 + b"\n", *lines[7:]]), 8, ""),
    ):
        path.write_bytes(data)
        assert main(["export", str(path), "--to", FORMAT]) == 1
        told = capsys.readouterr().err
        assert f"{path}:{number}: " in told and said in told
    assert not (old / "run/trace.koord-trace-2").exists()


def test_a_full_disk_keeps_what_stood_there(old: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with small_disk(tmp_path / "small", "60k") as small:
        (small / "own").write_text("of an earlier run")
        assert main(["export", str(old / "run"), "--to", FORMAT, "-o", str(small / "own")]) == 5
        assert f"error: {small / 'own'}: No space left on device" in capsys.readouterr().err
        assert (small / "own").read_text() == "of an earlier run"
        assert [path.name for path in small.iterdir()] == ["own"]


def test_the_next_run_takes_a_folder_with_a_renewed_trace(tmp_path: Path) -> None:
    with RunFolder(tmp_path) as run:
        shutil.copy(OLD / "run/trace.jsonl", run / "trace.jsonl")
    assert main(["export", str(run), "--to", FORMAT]) == 0
    with RunFolder(run):
        assert not (run / "trace.koord-trace-2").exists()


def test_an_examples_own_verdict_reads_both_formats(old: Path) -> None:
    run = old / "run"
    (run / "summary.json").write_text('{"verdict": "held", "why": "", "min_separation": null}')
    verdicts = []
    for _ in range(2):
        command = [sys.executable, str(OLD.parents[3] / "examples/lineform/verdict.py"), str(run)]
        verdicts.append(subprocess.run(command, capture_output=True, text=True, check=False))
        assert main(["export", str(run), "--to", FORMAT, "-o", str(run / "trace.jsonl")]) == 0
    assert verdicts[0].stdout == verdicts[1].stdout and "closest two robots" in verdicts[0].stdout
