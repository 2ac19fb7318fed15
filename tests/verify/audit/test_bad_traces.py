"""Traces that are cut off, broken, missing, or of another program."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from koordgen.cli import main
from koordgen.runtime.trace.schema import BadTrace
from koordgen.verify.audit.history import mission
from koordgen.verify.audit.trace_files import read_trace_file
from tests.verify.audit.fleets import audited, by_name
from tests.verify.audit.test_audit import HOLDS, edit, home_of

HEADER = {
    "kind": "header", "format": "koord-trace/1", "app": "a", "robot": "alice", "pid": 0, "n_sys": 2, "delta": 0.1,
    "program_hash": "0123456789abcdef",
}  # fmt: skip


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return home_of(tmp_path_factory.mktemp("flown"), HOLDS, 3.0)


@pytest.fixture
def home(flown: Path, tmp_path: Path) -> Path:
    shutil.copytree(flown, tmp_path / "home")
    return tmp_path / "home"


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    assert main(["audit", *map(str, arguments)]) == 1
    told = capsys.readouterr()
    assert not told.out and told.err.startswith("error: ")
    return told.err


def test_a_trace_of_another_program_names_both_files(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    edit(home / "cleo.jsonl", lambda r: r | {"program_hash": "0" * 16} if r["kind"] == "header" else r)
    told = refused(capsys, home)
    assert str(home / "alice.jsonl") in told and str(home / "cleo.jsonl") in told and "0000000000000000" in told
    edit(home / "cleo.jsonl", lambda r: r | {"app": "other"} if r["kind"] == "header" else r)
    assert "differ in the program: a and other" in refused(capsys, home)


def test_traces_of_another_version_than_the_program_are_refused(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (home / "source/a.koord").write_text(HOLDS.replace("mine < 6", "mine < 5"))
    assert "is the trace of a program with the hash" in refused(capsys, home)


def test_traces_of_different_missions_are_refused(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def other(record: dict[str, Any]) -> dict[str, Any]:
        if record.get("phase") == "running" and record["detail"].startswith("mission "):
            record["detail"] = "mission 00ff00ff00ff00ff, round 1 at 1.500 s of fleet time"
        return record

    edit(home / "bert.jsonl", other)
    told = refused(capsys, home)
    assert "are of different missions" in told and "00ff00ff00ff00ff" in told and str(home / "bert.jsonl") in told


def test_two_traces_of_one_robots_life_are_refused(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copy(home / "bert.jsonl", home / "copy.jsonl")
    told = refused(capsys, home)
    assert "bert.jsonl" in told and "copy.jsonl" in told and "both of robot bert" in told


def test_two_robots_of_one_pid_are_refused(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    edit(home / "cleo.jsonl", lambda r: r | {"pid": 1} if r["kind"] == "header" else r)
    assert "robot 1 is named cleo; in" in refused(capsys, home)


@pytest.mark.parametrize("data", [b"", b"\n", b"\x00" * 4096, bytes(range(256)) * 40, b"{}\n", b'{"kind":"header"}\n',
                                  b'{"kind":"header","format":"koord-trace/1"}\n', b"[" * 100_000])  # fmt: skip
def test_what_is_no_trace_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str], data: bytes) -> None:
    (tmp_path / "x.jsonl").write_bytes(data)
    assert str(tmp_path) in refused(capsys, tmp_path / "x.jsonl")
    assert str(tmp_path) in refused(capsys, tmp_path)


def test_a_file_that_is_not_there_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "No such file" in refused(capsys, tmp_path / "x.jsonl")


def test_a_trace_that_is_cut_off_is_used_as_far_as_it_goes(home: Path) -> None:
    data = (home / "bert.jsonl").read_bytes()
    half = data[: len(data) // 2]
    (home / "bert.jsonl").write_bytes(half)
    status, document = audited(home)
    place = f"{home / 'bert.jsonl'}:{half.count(chr(10).encode()) + 1}"
    assert status == 4 and f"{place}: the trace is cut off here" in document["notes"]
    mine = by_name(document)["Mine"]
    assert mine["verdict"] == "held" and [s["outcome"] for s in mine["spans"]] == ["held", "unknown"]
    assert mine["missing"] == {f"mine of bert: bert recorded nothing: {place} cannot be read": mine["unknown"]}


def broken_at(path: Path, round_: int, line: bytes) -> int:
    lines = path.read_bytes().splitlines(keepends=True)
    k = next(k for k, each in enumerate(lines) if f'"round":{round_},'.encode() in each)
    lines[k] = line
    path.write_bytes(b"".join(lines))
    return k + 1


@pytest.mark.parametrize("line", [b"no JSON\n", b"[1, 2]\n", b'{"kind":"round","round":"x","time":1}\n', b"\xff\xfe\n",
                                  b'{"kind":"round","round":9,"time":1,"sensors":7}\n',
                                  b"x" * (9 << 20) + b"\n"])  # fmt: skip
def test_a_line_that_is_no_record_costs_what_it_said(home: Path, line: bytes) -> None:
    number = broken_at(home / "bert.jsonl", 9, line)
    status, document = audited(home)
    assert status == 4 and document["notes"][0].startswith(f"{home / 'bert.jsonl'}:{number}: ")
    found = by_name(document)
    assert found["Mine"]["spans"][1] == {"since": 9, "until": found["Mine"]["spans"][1]["until"], "outcome": "unknown"}
    assert found["Near"]["spans"][0]["until"] == 7, "its position at the end of round 8 stood in that line"
    assert found["Near"]["spans"][1]["outcome"] == "unknown" and found["Near"]["spans"][-1]["outcome"] == "held"
    assert found["Sum"]["unknown"] <= 1


def test_a_line_that_says_nothing_of_a_round_costs_nothing(home: Path) -> None:
    lines = (home / "bert.jsonl").read_bytes().splitlines(keepends=True)
    (home / "bert.jsonl").write_bytes(b"".join([*lines[:-1], b"broken\n", lines[-1]]))
    status, document = audited(home)
    assert status == 4 and all(p["unknown"] == 0 for p in document["properties"])


@pytest.mark.parametrize(
    ("kind", "field", "value"),
    [
        ("round", "round", 1 << 52),
        ("round", "round", 90_000_000),
        ("round", "copy", {"turns": {"9" * 5000: 1, "\u0663": 2, "-1": 3}, "none": 4, "sum": [5]}),
        ("round", "sensors", {"Motion.position": [10**400, 0, 0], "Motion.reached": 7}),
        ("round", "locals", {"mine": 2.5}),
        ("round", "calls", [["Motion.planner", [[1, 2], 3, None], "x"], ["", [], None]]),
        ("round", "calls", [["Motion.planner"]]),
        ("round", "fault", {"reason": f"requires (line {'7' * 5000})", "line": []}),
        ("phase", "detail", f"mission ab, round 1 at {'9' * 5000}.1.2 s of fleet time"),
        ("monitor", "line", f"a.koord:{'9' * 5000}"),
        ("monitor", "round", 1 << 52),
        ("view", "members", [1 << 52, -1, 0]),
        ("init", "restored", True),
        ("init", "locals", {"mine": [[[[]]]], "none": None}),
    ],
)
def test_values_that_no_robot_writes_are_none(home: Path, kind: str, field: str, value: Any) -> None:
    record = {"kind": "monitor", "time": 3.0, "round": 5, "of": "invariant", "name": "Sum", "line": "a.koord:32",
              "outcome": "violated", "age": 1 << 40}  # fmt: skip
    with (home / "bert.jsonl").open("a") as file:
        file.write(json.dumps(record) + "\n")
    edit(home / "bert.jsonl", lambda r: r | {field: value} if r["kind"] == kind else r)
    status, document = audited(home)
    bad = [p for p in document["properties"] if p["verdict"] == "violated" and p["of"] != "well-defined"]
    assert status in (0, 3, 4) and not bad


def test_values_too_deep_to_look_at_are_refused_or_passed_over(home: Path) -> None:
    deep: Any = 1
    for _ in range(400):
        deep = [deep]
    edit(home / "bert.jsonl", lambda r: r | {"shared": {"sum": deep, "turns": deep}} if r["kind"] == "round" else r)
    assert main(["audit", str(home), "--format", "json"]) in (0, 1, 4)


def test_a_counterexample_is_no_trace_of_robots(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for more in ({"program_hash": ""}, {"counterexample": "run"}):
        (tmp_path / "x.jsonl").write_text(json.dumps(HEADER | more) + "\n")
        assert "a counterexample, which no robot ran" in refused(capsys, tmp_path / "x.jsonl")


@given(st.binary(max_size=400))
@settings(max_examples=60, deadline=None)
def test_bytes_behind_a_header_never_raise(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "fuzz.jsonl"
    path.write_bytes(json.dumps(HEADER, separators=(",", ":")).encode() + b"\n" + data)
    log = read_trace_file(path)
    assert mission([log]).last >= 0 and all(flaw.number > 0 for flaw in log.flaws)


_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3) | st.sampled_from(["round", "init"]),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["x", "0", "1", "mine", "round"]), inner)
    ),
    max_leaves=6,
)
_FIELDS = ("kind", "time", "round", "event", "skipped", "sensors", "locals", "shared", "actuators", "copy", "restored",
           "calls", "fault", "phase", "detail", "members", "number", "since", "of", "outcome", "line", "age", "pid",
           "robots", "n_sys", "delta")  # fmt: skip


@given(st.lists(st.tuples(st.integers(0, 200), st.sampled_from(_FIELDS), _JSON), min_size=1, max_size=4), st.data())
@settings(max_examples=20, deadline=None)
def test_records_with_other_fields_never_raise(flown: Path, changes: list[tuple[int, str, Any]], data: Any) -> None:
    """The whole command, on a trace some of whose records say something else in a field: a verdict or a refusal."""
    lines = [json.loads(line) for line in (flown / "bert.jsonl").read_text().splitlines()]
    for number, field, value in changes:
        lines[number % len(lines)][field] = value
    other = flown.parent / "fuzzed.jsonl"
    other.write_text("".join(json.dumps(line, separators=(",", ":")) + "\n" for line in lines))
    arguments = ["audit", str(flown / "alice.jsonl"), str(other), str(flown / "cleo.jsonl")]
    assert main([*arguments, "--program", str(flown / "source/a.koord"), "--format", "json"]) in (0, 1, 3, 4)


def test_a_header_of_nonsense_is_refused(tmp_path: Path) -> None:
    for field, value in (("n_sys", 10**9), ("n_sys", "x"), ("pid", 7), ("delta", 0), ("delta", 1e300), ("app", None)):
        header = {**HEADER, field: value}
        if field == "app":
            del header["app"]
        (tmp_path / "x.jsonl").write_text(json.dumps(header) + "\n")
        with pytest.raises(BadTrace, match="broken header"):
            read_trace_file(tmp_path / "x.jsonl")
