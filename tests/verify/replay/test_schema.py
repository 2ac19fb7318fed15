"""Trace schema: written traces fit it, its fields are documented, and old traces are converted."""

from __future__ import annotations

import io
import json
import math
import re
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.fixtures.fleet import Fleet
from benchmarks.fixtures.lineform import PROGRAM
from koordgen.cli.base import options
from koordgen.runtime.program.fleet_program import FleetProgram
from koordgen.runtime.program.program import Effects, Fault, Frame, Life
from koordgen.runtime.trace import schema
from koordgen.runtime.trace.schema import FORMAT, KINDS, OLD_FORMAT, RobotHeader, Upgrade, upgraded
from koordgen.runtime.trace.writer import RoundRecord, Trace
from tools import trace_tables

OLD = Path(__file__).parent / "old"
OLD_TRACES = sorted(OLD.rglob("*.jsonl"))


def written(*records: RoundRecord, **more: Any) -> list[dict[str, Any]]:
    out = io.BytesIO()
    trace = Trace(out, print)
    trace.header(FleetProgram.alone(PROGRAM, 2), "bert", 1, 2, 0.1)
    for record in records:
        trace.round(record, 0.0021, more)
    return [json.loads(line) for line in out.getvalue().splitlines()]


def test_the_docs_have_the_tables_of_the_schema() -> None:
    assert trace_tables.main(["--check"]) == 0, "python -m tools.trace_tables"


def test_every_key_of_the_schema_is_in_the_docs_with_a_meaning() -> None:
    page = trace_tables.PAGE.read_text(encoding="utf-8")
    for kind, type_ in KINDS.items():
        if kind != "header":
            section = page.partition(f"### Record `{kind}`")[2].partition("\n### ")[0]
            rows = re.findall(r"^\| `(\w+)` \| [^|]+\| [^|]*\| [^|]+ \|$", section, re.MULTILINE)
            assert rows == ["kind", *type_.__struct_fields__]


def test_a_field_without_a_meaning_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "schema.py").write_text('class End(msgspec.Struct):\n    """The end."""\n\n    t: float\n')
    monkeypatch.setattr(trace_tables, "SCHEMA", tmp_path / "schema.py")
    with pytest.raises(trace_tables.NoComment, match="t has no comment"):
        trace_tables.tables()


def test_each_key_of_a_round_has_its_own_value() -> None:
    frame = Frame(1, 2, {"n": 1, "m": 2}, {"x": (1, 2), "sum": 3}, {}, {})
    effects = Effects({"n": 4, "m": 2}, {"sum": 5}, {"Motion.target": 6}, True, violated=(7,))
    full = RoundRecord(
        8, 9.0, 0.00101, {"Motion.position": 10}, frame, "Go", effects, "fault", Fault("a.koord", 11, "1 / 0"),
        (("Planner.ask", (12,), 13),), Life(14, {"n": 15}, {"Motion.target": 16}, False),
    )  # fmt: skip
    header, whole, bare = written(full, RoundRecord(17, 18.0, 0.0, {}, None, skipped="not current"), heard=19)
    assert header == {
        "kind": "header", "format": FORMAT, "app": PROGRAM.name, "applications": [PROGRAM.name], "robot": "bert",
        "pid": 1, "n_sys": 2, "delta": 0.1, "program_hash": PROGRAM.program_hash,
    }  # fmt: skip
    assert whole == {
        "kind": "round", "round": 8, "event": "Go", "skipped": "fault",
        "fault": {"file": "a.koord", "line": 11, "reason": "1 / 0"}, "late": 0.00101,
        "sensors": {"Motion.position": 10}, "locals": {"n": 4}, "shared": {"sum": 5},
        "actuators": {"Motion.target": 6}, "copy": {"x": {"0": 1, "1": 2}, "sum": 3},
        "calls": [["Planner.ask", [12], 13]], "violated": [7], "stopped": True,
        "restored": {"round": 14, "locals": {"n": 15}, "actuators": {"Motion.target": 16}, "stopped": False},
        "clock_bound": 0.0021, "counters": {"heard": 19}, "time": 9.0, "application": PROGRAM.name,
    }  # fmt: skip
    assert bare == {
        "kind": "round", "round": 17, "event": None, "skipped": "not current", "fault": None, "late": 0.0,
        "sensors": {}, "shared": {}, "actuators": {}, "clock_bound": 0.0021, "counters": {"heard": 19}, "time": 18.0,
        "application": PROGRAM.name,
    }  # fmt: skip


def test_a_robot_that_does_not_know_the_fleets_time_writes_a_record_that_readers_accept() -> None:
    """So it is right after a restart, until the first exchange with another robot."""
    file = io.BytesIO()
    Trace(file, print).round(RoundRecord(1, 2.0, 0.0, {}, None, skipped="not current"), math.inf, {})
    assert json.loads(file.getvalue())["clock_bound"] is None and schema.misfit(file.getvalue()) == ""


def test_all_that_robots_write_fits_the_schema() -> None:
    fleet = Fleet().boot_all()
    fleet.run_told(120)
    lines = [line for robot in fleet.robots.values() for line in robot.file.getvalue().splitlines()]
    kinds = set()
    for line in lines:
        record = json.loads(line)
        kinds.add(record["kind"])
        header = record["kind"] == "header"
        assert (schema.decoded_header if header else schema.decoded)(line) is not None
        known = RobotHeader if header else KINDS[record["kind"]]
        assert set(record) - {"kind"} <= set(known.__struct_fields__)
        assert ("application" in record) == (record["kind"] in schema.OF_APPLICATIONS)
    assert kinds >= {"header", "phase", "init", "round", "view", "metrics"}


def test_what_can_be_exported_names_the_present_format() -> None:
    source = Path(options.__file__).read_text(encoding="utf-8")
    assert f'"mp4", "{FORMAT}")' in source, "the command line does not load the schema"


@pytest.mark.parametrize("path", OLD_TRACES, ids=lambda path: str(path.relative_to(OLD)))
def test_an_old_trace_becomes_a_new_one_and_loses_nothing(path: Path) -> None:
    old = path.read_bytes().splitlines(keepends=True)
    new = list(map(Upgrade().line, old))
    assert list(map(Upgrade().line, new)) == new, "what is new stays as it is"
    for before, after in zip(map(json.loads, old), map(json.loads, new), strict=True):
        assert schema.misfit(json.dumps(after).encode()) == "" or after["kind"] == "header"
        if before["kind"] == "header":
            assert before["format"] == OLD_FORMAT
            assert after == before | {"format": FORMAT, "applications": [before["app"]]}
        elif before["kind"] in schema.OF_APPLICATIONS:
            assert after == before | {"application": json.loads(old[0])["app"]}
        else:
            assert after == before


def test_only_violations_of_an_application_name_it() -> None:
    for what, named in (("property", True), ("fault", True), ("separation", False), ("collision", False)):
        line = json.dumps({"kind": "violation", "t": 1.0, "what": what, "robots": [], "detail": ""}).encode()
        assert (b'"application":"a"' in upgraded(line, "a")) == named


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"\n",
        b"no JSON",
        b"[1]",
        b'{"kind":7}',
        b'{"kind":"round","\xff":1}',
        b'{"kind":"\xff"}',
        b'{"kind":"new","x":NaN}',
        b"[" * 100_000,
    ],
)
def test_what_is_no_record_stays_as_it_is(line: bytes) -> None:
    assert upgraded(line, "a") == line


def test_a_later_format_is_named() -> None:
    header = b'{"kind":"header","format":"koord-trace/3","app":"a"}\n'
    with pytest.raises(ValueError, match="its format is koord-trace/3; this koordgen reads koord-trace/1 and koord-tr"):
        Upgrade().line(header)
    assert schema.format_of(b'{"kind":"header","format":"other/1"}') == ""


@given(st.integers(0, 10**6), st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), min_size=1, max_size=3))
@settings(max_examples=300, deadline=None)
def test_a_damaged_line_is_a_record_or_none(number: int, changes: list[tuple[int, int]]) -> None:
    lines = (OLD / "run/robots/alice/trace.jsonl").read_bytes().splitlines()
    line = bytearray(lines[number % len(lines)])
    for place, byte in changes:
        line[place % len(line)] = byte
    if not line.startswith(b'{"kind":"header"'):
        new = upgraded(bytes(line), "a")
        schema.misfit(new)
        with suppress(msgspec.DecodeError):
            schema.decoded(new)
