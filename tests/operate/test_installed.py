"""Robots whose agents do not answer: their rows show what their hosts say."""

from __future__ import annotations

import asyncio
import json
from typing import Any

from koordgen.operate.estop import Place
from koordgen.operate.installed import Installed, installed
from koordgen.operate.status import StatusAnswer, odd_releases, table, to_json, with_hosts
from tests.operate.fakes import FakeSession, reached, unreachable

RELEASE = "ab" * 16


class Off(FakeSession):
    """A host on which no agent runs."""

    def answer_inspect(self) -> dict[str, Any]:
        return {
            "deployment": self.deployment,
            "builds": dict.fromkeys(self.host.robots, RELEASE),
            "robots": {robot: {"running": robot == "dora", "phase": None} for robot in self.host.robots},
            "free": 21_000_000_000,
            "temperature": 48.4,
            "uptime": 10_800.0,
        }


def report(release: str = RELEASE, **more: Any) -> dict[str, Any]:
    return {
        "robot": "alice", "release": release, "phase": "running", "round": 7, "current": 7, "rounds": 7, "peers": {},
        "late_ms": None, "monitors": {"violated": []}, "host": {"clock_ms": None, "disk_gb": 1.0, "temperature": None},
        **more,
    }  # fmt: skip


def asked(name: str, answer: dict[str, Any] | None = None) -> StatusAnswer:
    return StatusAnswer(Place(name, "10.0.0.7", 48100), answer, 0.1, "" if answer else "no answer")


def looked(*sessions: FakeSession) -> list[StatusAnswer]:
    found, failed = asyncio.run(installed(reached(*sessions, failed=(unreachable("emil"),))))
    answers = [asked("alice", report(battery=0.62)), *map(asked, ("bert", "dora", "emil"))]
    return with_hosts(answers, found, {robot: error.message for robot, error in failed.items()})


def test_a_row_shows_what_the_host_says() -> None:
    answers = looked(Off("bert", "dora", pending="c" * 16))
    head, alice, bert, dora, emil = table(answers).splitlines()
    assert "battery  disk" in head and "62%" in alice.split()
    assert bert.split()[:2] == ["bert", "abababab"] and "21.0 GB" in bert and "48 °C" in bert
    assert "its agent does not run; host up for 3 h; release cccccccc is not confirmed (10.0.0.7:48100)" in bert
    assert "its agent runs (phase unknown), but does not answer" in dora
    assert "no answer; SSH: refuses connections" in emil
    assert odd_releases(answers) == {}
    document = json.loads(to_json(answers))["robots"]
    assert [each["host"] is not None for each in document] == [False, True, True, False]
    assert document[1]["host"]["uptime"] == 10_800.0 and document[1]["host"]["pending"] == "c" * 16


def test_a_release_that_is_only_installed_is_odd_too() -> None:
    answers = [asked("alice", report()), asked("bert", report()), asked("cleo")]
    assert odd_releases(answers) == {}
    found = {"cleo": Installed("cd" * 16, "a" * 16, "", False, "", 1, None, 1.0)}
    assert odd_releases(with_hosts(answers, found, {})) == {"cleo": "cd" * 16}


def test_robots_with_another_key_are_odd_although_they_have_the_same_bundles() -> None:
    hosts = {
        name: Installed(RELEASE, key * 16, "", False, "", 1, None, 1.0)
        for name, key in zip(("alice", "bert", "cleo"), "aab", strict=True)
    }
    answers = with_hosts([asked(name) for name in hosts], hosts, {})
    assert odd_releases(answers) == {"cleo": "b" * 16}
    assert "robots whose release differs from most: cleo (bbbbbbbb)" in table(answers)
