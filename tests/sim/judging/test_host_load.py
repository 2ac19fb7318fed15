"""Violations that the host caused because a process got no core: they are measured and have their own verdict."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from koordgen.runtime.program.runner import LATE
from koordgen.runtime.trace.schema import End, EventFault, Mark, Round, Violation
from targets.sim import harness
from targets.sim.judging import host_load
from targets.sim.judging.host_load import SIMULATOR, HostLoad, waited
from tests.sim.run.fake_fleet import bundle, enlist

DELTA, ZERO = 0.1, 50.0
MOVING = "a.koord:7"


class Host:
    """A run of ann, bob and the simulator, whose counters the test sets."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.counters: dict[int, float | None] = {1: 0.0, 2: 0.0, os.getpid(): 0.0}
        self.time = ZERO
        self.marked: list[Violation] = []
        self.agents = [SimpleNamespace(robot=SimpleNamespace(name=name), process_id=k, delta=DELTA) for k, name in
                       enumerate(("ann", "bob"), 1)]  # fmt: skip
        monkeypatch.setattr(host_load, "waited", self.counters.get)
        self.load = HostLoad(DELTA, {MOVING})
        self.load.launched(SimpleNamespace(conduct=self, mark=self.marked.append))  # type: ignore[arg-type]

    def passes(self, seconds: float, **waits: float) -> None:
        """Let time pass, in which processes wait for a core for so long; the counter shows a wait at its end."""
        process = {"ann": 1, "bob": 2, "simulator": os.getpid()}
        last = self.time + seconds
        while self.time < last - 1e-9:
            self.time += DELTA / 4
            for name in [name for name, wait in waits.items() if self.time >= last - seconds + wait - 1e-9]:
                counter, wait = self.counters[process[name]], waits.pop(name)
                self.counters[process[name]] = None if counter is None else counter + wait
            self.load.sample(self.time)

    def now(self) -> float:
        return self.time

    def hears(self, reason: str, at: float, robot: int = 0) -> None:
        fault = EventFault("a.koord", 0 if reason == LATE else 9, reason)
        self.load.heard(self.agents[robot], [Round(3, fault=fault, time=at, late=0.0)])  # type: ignore[arg-type]

    def why(self, what: str, at: float, *robots: str, detail: str = "", line: str = "") -> str:
        marks: list[Mark] = [Violation(at - ZERO, what, robots, detail, line=line), End(9.0, "completed")]
        found, end = self.load.explained(marks, ZERO)
        assert isinstance(found, Violation) and isinstance(end, End)
        return found.host


@pytest.fixture
def host(monkeypatch: pytest.MonkeyPatch) -> Host:
    return Host(monkeypatch)


def late(host: Host, name: str = "ann") -> str:
    return host.why("fault", ZERO, name, detail=f"a.koord: {LATE}")


def test_an_event_that_hosts_a_squad_has_a_small_part_of_the_time(host: Host) -> None:
    host.agents[0].robot.name = "alpha.ann"
    fault = EventFault("a.koord", 0, LATE)
    host.passes(1.0)
    host.passes(0.2, ann=0.02)
    for application, robot in (("triangle", "alpha.ann"), ("outer", "alpha.ann"), ("outer", "bob")):
        record = Round(3, fault=fault, time=ZERO + 1.0, late=0.0, application=application)
        agent = host.agents[robot == "bob"]
        assert bool(host.load._why_late(agent, record)) == (robot == "alpha.ann" and application == "outer")  # type: ignore[arg-type]


def test_an_event_that_had_no_core_is_late_by_the_host(host: Host) -> None:
    host.passes(1.0)
    host.passes(0.2, ann=0.08)
    host.hears(LATE, ZERO + 1.0)
    assert "ann's agent no core for 50 of the 50 ms" in late(host)
    assert late(host, "bob") == ""


def test_an_event_that_had_a_core_is_late_by_itself(host: Host) -> None:
    host.passes(1.0, ann=0.9)
    host.passes(0.1, ann=0.02)
    host.passes(0.1, ann=0.05)  # after the event's deadline
    host.hears(LATE, ZERO + 1.0)
    assert late(host) == ""


def test_one_late_event_of_its_own_is_enough_for_a_robot(host: Host) -> None:
    host.passes(0.1)
    host.passes(0.2, ann=0.1)
    host.hears(LATE, ZERO + 0.1)
    assert late(host)
    host.passes(0.2)
    host.hears(LATE, ZERO + 0.3)
    assert late(host) == ""


def test_a_fault_behind_one_that_the_host_caused_is_told(host: Host) -> None:
    host.passes(0.1)
    host.passes(0.2, ann=0.1)
    host.hears(LATE, ZERO + 0.1)
    host.hears("1 / 0", ZERO + 0.2)
    host.hears("1 / 0", ZERO + 0.3)
    (violation,) = host.marked
    assert (violation.what, violation.robots, violation.detail) == ("fault", ("ann",), "a.koord:9: 1 / 0")
    assert host.why("fault", ZERO + 0.2, "ann", detail=violation.detail) == ""


def test_what_bodies_do_while_their_agent_has_no_core_is_the_hosts(host: Host) -> None:
    host.passes(1.0)
    host.passes(1.0, bob=0.6)
    at = ZERO + 2.0
    assert "bob's agent no core for 0.6 s" in host.why("collision", at, "ann", "bob")
    assert host.why("separation", at, "bob") and host.why("property", at, line=MOVING)
    assert host.why("collision", ZERO + 1.3, "bob")  # meanwhile
    assert host.why("collision", at, "ann") == host.why("collision", at + 1.0, "ann", "bob") == ""
    assert host.why("property", at, "bob", line="a.koord:8") == ""  # it does not read where bodies are
    assert host.why("ended", at, "bob") == host.why("fault", at, "bob", detail="a.koord:9: 1 / 0") == ""
    host.passes(3.0, simulator=0.8)
    assert SIMULATOR in host.why("collision", ZERO + 3.0, "ann")


def test_many_short_waits_explain_nothing(host: Host) -> None:
    for _ in range(40):
        host.passes(DELTA, ann=0.09, bob=0.09, simulator=0.09)
    assert host.load.totals["ann"] == pytest.approx(3.6)
    assert host.why("collision", host.time, "ann", "bob") == ""


def test_where_nothing_is_measured_nothing_is_explained(host: Host) -> None:
    host.counters.update(dict.fromkeys(host.counters))
    host.passes(1.0, ann=1.0)
    host.hears(LATE, ZERO)
    assert late(host) == host.why("collision", ZERO, "ann", "bob") == "" and host.load.totals == {}
    assert waited(2**31 - 1) is None


@pytest.mark.skipif(waited(os.getpid()) is None, reason="this system does not count what processes wait for a core")
def test_a_process_that_shares_a_core_waits_for_it() -> None:
    core = min(os.sched_getaffinity(0))
    code = f"import os\nos.sched_setaffinity(0, [{core}])\nwhile 1: 0"
    busy = [subprocess.Popen([sys.executable, "-c", code]) for _ in range(2)]
    try:
        while not all((waited(each.pid) or 0.0) > 0.05 for each in busy):
            time.sleep(0.05)
    finally:
        for each in busy:
            each.kill()
            each.wait()


@pytest.mark.slow
def test_a_run_whose_agents_had_no_core_has_its_own_status(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    enlist()
    monkeypatch.setattr(host_load, "waited", lambda process: time.monotonic())  # they wait all the time
    for how, status, verdict, report in (
        ("late", 6, "host overloaded", []), ("late and faulty", 3, "violated", ["--no-report"]),
    ):  # fmt: skip
        root, out = bundle(tmp_path / how / "sim", [how, "good"]), tmp_path / how / "out"
        assert harness.main(root, ["--duration", "2", "--out", str(out), "--quiet", *report]) == status
        found: dict[str, Any] = json.loads((out / "summary.json").read_text())
        assert found["verdict"] == verdict
        assert "the host gave r0's agent no core" in found["violations"][0]["host"]
        assert set(found["host_waits"]) == {"r0", "r1", SIMULATOR}
        said, error = capsys.readouterr()
        assert error.startswith("error: the host was overloaded") == (status == 6)
        assert ":0:" not in said and (report or ":0:" not in (out / "report.html").read_text())
        assert ("--lockstep" in said) == (status == 6)
        assert ("a.koord:3: 1 / 0" in found["why"]) == (status == 3)
