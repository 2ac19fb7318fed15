"""Traces and logs of robots come home: all bytes once, and no partial file under a whole one's name."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from koordgen.operate.collect import (
    AT_ONCE,
    MARKER,
    OVERLAP,
    CannotCollect,
    Collected,
    CollectionFolder,
    collect,
    collect_all,
)
from koordgen.operate.hosts import HostError
from tests.operate.fakes import FakeSession, reached, unreachable


@pytest.fixture
def alice(tmp_path: Path) -> FakeSession:
    session = FakeSession("alice")
    session.traces["alice"] = tmp_path / "host"
    session.traces["alice"].mkdir()
    return session


def written(session: FakeSession, name: str, count: int, first: int = 0) -> bytes:
    """Append records to a trace on the host; return all of it."""
    path = session.traces["alice"] / name
    with path.open("ab") as file:
        file.writelines(
            b'{"kind":"round","round":%d,"of":"%s"}\n' % (i, name.encode()) for i in range(first, first + count)
        )
    return path.read_bytes()


def collected(session: FakeSession, folder: Path) -> Collected:
    with CollectionFolder(folder) as into:
        return asyncio.run(collect(session, "alice", into, 10.0, lambda count: None))


def test_all_files_arrive_as_they_are(alice: FakeSession, tmp_path: Path) -> None:
    older, current = written(alice, "trace-1.jsonl", 50_000), written(alice, "trace.jsonl", 10)
    alice.lines["alice"] = [(1010.5, "flying"), (1011.0, "landing: ä")]
    assert len(older) > AT_ONCE
    found = collected(alice, tmp_path / "run")
    home = tmp_path / "run/robots/alice"
    assert (home / "trace-1.jsonl").read_bytes() == older and (home / "trace.jsonl").read_bytes() == current
    assert (home / "log.txt").read_text() == "1000.500 flying\n1001.000 landing: ä\n"
    assert sorted(each.name for each in home.iterdir()) == ["log.txt", "trace-1.jsonl", "trace.jsonl"]
    assert found == Collected("alice", 3, len(older) + len(current) + (home / "log.txt").stat().st_size)


def test_only_missing_bytes_travel_the_second_time(alice: FakeSession, tmp_path: Path) -> None:
    written(alice, "trace-1.jsonl", 5000)
    before = len(written(alice, "trace.jsonl", 5000))
    alice.lines["alice"] = [(1.0, "one")]
    collected(alice, tmp_path / "run")
    alice.fetched = 0
    assert collected(alice, tmp_path / "run").fetched == alice.fetched == 2 * OVERLAP
    grown = written(alice, "trace.jsonl", 100, 5000)
    alice.lines["alice"].append((12.0, "two"))
    found = collected(alice, tmp_path / "run")
    home = tmp_path / "run/robots/alice"
    assert found.fetched == len(grown) - before + 2 * OVERLAP + len("2.000 two\n")
    assert (home / "trace.jsonl").read_bytes() == grown
    assert (home / "log.txt").read_text() == "-9.000 one\n2.000 two\n"


def test_a_trace_that_became_an_older_part_is_recognised(alice: FakeSession, tmp_path: Path) -> None:
    first = len(written(alice, "trace.jsonl", 3000))
    collected(alice, tmp_path / "run")
    whole = written(alice, "trace.jsonl", 200, 3000)
    (alice.traces["alice"] / "trace.jsonl").rename(alice.traces["alice"] / "trace-1.jsonl")
    current = written(alice, "trace.jsonl", 7)
    found = collected(alice, tmp_path / "run")
    home = tmp_path / "run/robots/alice"
    assert (home / "trace-1.jsonl").read_bytes() == whole and (home / "trace.jsonl").read_bytes() == current
    assert found.fetched == len(whole) - first + len(current) + 2 * OVERLAP


def test_a_part_that_the_robot_has_deleted_stays_here(alice: FakeSession, tmp_path: Path) -> None:
    first = written(alice, "trace.jsonl", 30)
    collected(alice, tmp_path / "run")
    (alice.traces["alice"] / "trace.jsonl").unlink()
    second, third = written(alice, "trace-2.jsonl", 20), written(alice, "trace.jsonl", 10)
    collected(alice, tmp_path / "run")
    home = tmp_path / "run/robots/alice"
    assert [(home / f"trace{n}.jsonl").read_bytes() for n in ("-1", "-2", "")] == [first, second, third]


def test_a_cut_link_leaves_no_file_that_looks_whole_and_the_next_time_goes_on(
    alice: FakeSession, tmp_path: Path
) -> None:
    whole = written(alice, "trace.jsonl", 80_000)
    alice.cut_after = AT_ONCE + 1
    home = tmp_path / "run/robots/alice"
    with pytest.raises(HostError, match="cut"):
        collected(alice, tmp_path / "run")
    assert [each.name for each in home.iterdir()] == ["trace.jsonl.part"]
    arrived = (home / "trace.jsonl.part").stat().st_size
    assert arrived == AT_ONCE
    alice.cut_after, alice.fetched = 1 << 40, 0
    collected(alice, tmp_path / "run")
    assert (home / "trace.jsonl").read_bytes() == whole and not (home / "trace.jsonl.part").exists()
    assert alice.fetched == len(whole) - arrived + OVERLAP


def test_a_whole_file_stays_while_more_of_it_arrives(alice: FakeSession, tmp_path: Path) -> None:
    first = written(alice, "trace.jsonl", 10)
    collected(alice, tmp_path / "run")
    whole = written(alice, "trace.jsonl", 80_000, 10)
    alice.cut_after = alice.fetched + AT_ONCE + OVERLAP
    with pytest.raises(HostError):
        collected(alice, tmp_path / "run")
    home = tmp_path / "run/robots/alice"
    assert (home / "trace.jsonl").read_bytes() == first
    alice.cut_after = 1 << 40
    collected(alice, tmp_path / "run")
    assert (home / "trace.jsonl").read_bytes() == whole


def test_a_part_that_begins_while_the_trace_is_fetched_harms_nothing(alice: FakeSession, tmp_path: Path) -> None:
    first = written(alice, "trace.jsonl", 100)
    listed = alice.answer_traces("alice")

    def lists(robot: str) -> dict[str, Any]:
        """Answer with the files of before, and begin another part at once."""
        del alice.answer_traces
        (alice.traces["alice"] / "trace.jsonl").rename(alice.traces["alice"] / "trace-1.jsonl")
        written(alice, "trace.jsonl", 300, 5000)
        return listed

    alice.answer_traces = lists  # type: ignore[method-assign]
    collected(alice, tmp_path / "run")
    collected(alice, tmp_path / "run")
    home = tmp_path / "run/robots/alice"
    assert (home / "trace-1.jsonl").read_bytes() == first
    assert (home / "trace.jsonl").read_bytes() == (alice.traces["alice"] / "trace.jsonl").read_bytes()


def test_a_whole_fleet_is_collected_and_robots_that_are_missed_are_named(alice: FakeSession, tmp_path: Path) -> None:
    bert = FakeSession("bert", "cleo")
    for robot in ("bert", "cleo"):
        bert.traces[robot] = tmp_path / robot
        bert.traces[robot].mkdir()
    (bert.traces["cleo"] / "trace.jsonl").write_bytes(b"{}\n")
    bert.lines["cleo"] = [(1000.0, "hello")]
    bert.ahead, bert.deployment["history"] = 100.0, ["b" * 16, "c" * 16]
    alice.broken.add("fetch")
    written(alice, "trace.jsonl", 1)
    with CollectionFolder(tmp_path / "run") as into:
        sessions = reached(bert, alice, failed=(unreachable("dora"),))
        found = asyncio.run(collect_all(sessions, into, lambda count: None))
    assert {name: each.files for name, each in found.robots.items()} == {"bert": 1, "cleo": 2}
    assert set(found.missed) == {"alice", "dora"}
    assert found.programs == {"": [{"a.koord": letter.encode() * 16} for letter in "acb"]}
    (line,) = (tmp_path / "run/robots/cleo/log.txt").read_text().splitlines()
    assert float(line.split()[0]) == pytest.approx(900.0, abs=1.0)


@pytest.mark.parametrize("count", [5, 500])
def test_another_recording_is_never_mixed_with_this_one(alice: FakeSession, tmp_path: Path, count: int) -> None:
    first = written(alice, "trace.jsonl", 100)
    collected(alice, tmp_path / "run")
    (alice.traces["alice"] / "trace.jsonl").unlink()
    written(alice, "trace.jsonl", count, 7000)
    with pytest.raises(CannotCollect, match=r"trace\.jsonl is of another recording"):
        collected(alice, tmp_path / "run")
    assert (tmp_path / "run/robots/alice/trace.jsonl").read_bytes() == first


@pytest.mark.parametrize("name", ["../trace.jsonl", "passwd", "trace/../../x.jsonl"])
def test_names_of_a_host_do_not_leave_the_folder(alice: FakeSession, tmp_path: Path, name: str) -> None:
    alice.answer_traces = lambda robot: {"files": [{"name": name, "size": 3}]}  # type: ignore[method-assign]
    with pytest.raises(CannotCollect, match="which is no trace"):
        collected(alice, tmp_path / "run")


def test_a_folder_of_others_is_not_written_to(alice: FakeSession, tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run/thesis.tex").write_text("x")
    with pytest.raises(CannotCollect, match="did not write"):
        collected(alice, tmp_path / "run")
    with CollectionFolder(tmp_path / "new"), pytest.raises(CannotCollect, match="another collection"):
        collected(alice, tmp_path / "new")
    assert (tmp_path / "new" / MARKER).is_file()
