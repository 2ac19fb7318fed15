"""Agents start only where all hosts have the same confirmed release; stop reaches all that can be reached."""

from __future__ import annotations

import asyncio

import pytest

from koordgen.operate.hosts import HostError
from koordgen.operate.services import ServiceRefused, start, stop
from tests.operate.fakes import FakeSession, reached, unreachable


def test_all_robots_of_one_release_start() -> None:
    one, two = FakeSession("alice", "bert"), FakeSession("cleo")
    done = asyncio.run(start(reached(one, two)))
    assert (done.robots, done.idle, done.release, done.failed) == (("alice", "cleo"), ("bert",), "a" * 16, ())
    assert one.calls[-1] == ("start", {"robots": ["alice", "bert"]})


@pytest.mark.parametrize(
    ("odd", "said"),
    [
        (FakeSession("cleo", confirmed="b" * 16), "aaaaaaaa on alice, bert; bbbbbbbb on cleo"),
        (FakeSession("cleo", pending="c" * 16), r"not confirmed yet \(cleo: cccccccc\)"),
        (FakeSession("cleo", confirmed=None), "there is no release on cleo"),
    ],
)
def test_nothing_starts_in_a_mixed_fleet(odd: FakeSession, said: str) -> None:
    one = FakeSession("alice", "bert")
    with pytest.raises(ServiceRefused, match=said) as refused:
        asyncio.run(start(reached(one, odd)))
    assert "nothing was started" in refused.value.help
    assert [verb for session in (one, odd) for verb, _ in session.calls] == ["inspect", "inspect"]


def test_nothing_starts_when_a_host_does_not_answer() -> None:
    one, two = FakeSession("alice"), FakeSession("bert")
    with pytest.raises(HostError, match="cleo"):
        asyncio.run(start(reached(one, two, failed=(unreachable("cleo"),))))
    two.broken.add("inspect")
    with pytest.raises(HostError, match="bert"):
        asyncio.run(start(reached(one, two)))
    assert all(verb == "inspect" for verb, _ in one.calls)


def test_a_host_that_fails_to_start_is_named() -> None:
    one, two = FakeSession("alice"), FakeSession("bert")
    two.broken.add("start")
    done = asyncio.run(start(reached(one, two)))
    assert done.robots == ("alice",) and [error.host.robots for error in done.failed] == [("bert",)]


def test_stop_reaches_all_that_can_be_reached() -> None:
    one, two = FakeSession("alice", "bert"), FakeSession("emil")
    two.broken.add("stop")
    done = asyncio.run(stop(reached(one, two, failed=(unreachable("cleo"),)), 9.0))
    assert (done.robots, done.idle) == (("alice",), ("bert",))
    assert [error.host.robots for error in done.failed] == [("cleo",), ("emil",)]
    assert one.calls == [("stop", {"robots": ["alice", "bert"], "seconds": 9.0})]
