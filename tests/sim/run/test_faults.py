"""Faults come when they are due, go when they are over, and are stamped into the trace."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from koordgen.runtime.net.network import Conditions
from koordgen.runtime.trace.schema import Cause, Moved, Wind
from koordgen.runtime.values.obstacles import Sphere
from koordgen.runtime.values.points import Point
from targets.sim.base.fault_state import NO_POSITIONING_FAULT, FaultState
from targets.sim.base.medium import Medium
from targets.sim.base.scenario import BadScenario
from targets.sim.base.schedule import Schedule, read
from targets.sim.run.faults import Faults, check_obstacles, check_times, load, with_network

ROBOTS = ("ann", "bob", "cem")
LAUNCH, ZERO = 100.0, 103.0  # of the run's clock


class FakeRun:
    """As much of a run as faults see of it; `done` is what was done to it, and when."""

    def __init__(self) -> None:
        self.now = LAUNCH
        self.zero: float | None = None
        self.done: list[tuple[float, Any]] = []
        self.marks: list[Any] = []
        self.scenario = SimpleNamespace(
            robots=[SimpleNamespace(name=name) for name in ROBOTS], world=SimpleNamespace(wind=Wind())
        )
        agents = [self._agent(name) for name in ROBOTS]
        self.conduct = SimpleNamespace(
            agents=agents, now=lambda: self.now, disturb=lambda medium: self._do("disturb", medium)
        )
        self.upsets = [FaultState() for _ in ROBOTS]
        self.scene = SimpleNamespace(
            actors=[SimpleNamespace(fault_state=fault_state) for fault_state in self.upsets],
            world=SimpleNamespace(blow=lambda wind: self._do("blow", wind), move=self._move),
        )

    def _agent(self, name: str) -> Any:
        return SimpleNamespace(
            crash=lambda: self._do("crash", name), restart=lambda: self._do("restart", name),
            freeze=lambda seconds: self._do("freeze", (name, seconds)), asked_to_end=False, alive=True, crashed=False,
            frozen=False, thaw=lambda: self._do("thaw", name),
        )  # fmt: skip

    def _do(self, *what: Any) -> None:
        self.done.append((round(self.now - ZERO, 6), what))

    def _move(self, number: int, by: tuple[float, float, float]) -> Sphere:
        self._do("move", (number, by))
        return Sphere(Point(*by), 1.0)

    def mark(self, cause: Any) -> None:
        self.marks.append(cause)

    def t(self, at: float) -> float | None:
        return None if self.zero is None else at - self.zero

    def through(self, faults: Faults, seconds: float) -> None:
        faults.launched(self)  # type: ignore[arg-type]
        steps = round((ZERO - LAUNCH + seconds) * 4)
        for k in range(steps + 1):
            self.now = LAUNCH + k / 4
            if self.now >= ZERO + 0.5:  # it is heard of later
                self.zero = ZERO
            faults.step(self.now, [])


def run(**data: Any) -> FakeRun:
    schedule, mistakes = read(data, ROBOTS)
    assert not mistakes
    made = FakeRun()
    made.through(Faults(schedule), 10.0)
    return made


def test_a_crash_that_lasts_ends_in_a_restart() -> None:
    made = run(events=[{"at": 2, "for": 3, "crash": "bob"}])
    assert made.done == [(2.0, ("crash", "bob")), (5.0, ("restart", "bob"))]
    assert made.marks == [
        Cause(ZERO + 2, "crash", ("bob",), "", 3.0), Cause(ZERO + 5, "restart", ("bob",), "3 s after its crash"),
    ]  # fmt: skip


def test_what_is_due_at_once_waits_for_round_1_to_be_heard_of() -> None:
    assert run(events=[{"at": 0, "freeze": "ann", "for": 1.5}]).done == [(0.5, ("freeze", ("ann", 1.5)))]


def test_a_partition_heals() -> None:
    made = run(network={"loss": 0.1}, events=[{"at": 2, "for": 3, "partition": [["ann"], ["bob", "cem"]]}])
    whole = Medium(Conditions(loss=0.1))
    assert made.done == [
        (LAUNCH - ZERO, ("disturb", whole)),
        (2.0, ("disturb", Medium(Conditions(loss=0.1), groups=(0, 1, 1)))),
        (5.0, ("disturb", whole)),
    ]
    assert [(cause.what, cause.detail) for cause in made.marks] == [
        ("network", "loss 0.1, delay 0.001"), ("partition", "ann | bob, cem"),
    ]  # fmt: skip


def test_one_partition_may_follow_another_at_once() -> None:
    made = run(events=[{"at": 2, "for": 1, "partition": [["ann"], ["bob", "cem"]]},
                       {"at": 3, "for": 1, "partition": [["ann", "bob"], ["cem"]]}])  # fmt: skip
    assert [medium.groups for _, (_, medium) in made.done] == [(), (0, 1, 1), (), (0, 0, 1), ()]


def test_links_are_cut_and_restored_beside_a_partition() -> None:
    events = [
        {"at": 1, "cut": ["cem", "ann"]},
        {"at": 2, "for": 2, "partition": [["ann"], ["bob", "cem"]]},
        {"at": 3, "restore": ["ann", "cem"]},
        {"at": 5, "for": 1, "network": {"loss": 0.5}},
    ]
    made = run(events=events, links=[{"from": "ann", "to": "bob", "delay": 1}])
    media = [medium for _, (_, medium) in made.done]
    assert [(medium.groups, medium.cuts) for medium in media] == [
        ((), ()), ((), ((0, 2),)), ((0, 1, 1), ((0, 2),)), ((0, 1, 1), ()), ((), ()), ((), ()), ((), ()),
    ]  # fmt: skip
    assert [medium.all.loss for medium in media] == [0, 0, 0, 0, 0, 0.5, 0]
    assert media[5].links == ((0, 1, Conditions(loss=0.5, delay=1.0)),)
    assert media[1].cut(0, 2) and media[1].cut(2, 0) and not media[1].cut(0, 1)
    assert [(cause.what, cause.robots, cause.detail) for cause in made.marks[1:]] == [
        ("cut", ("cem", "ann"), "between cem and ann"), ("partition", ROBOTS, "ann | bob, cem"),
        ("restore", ("ann", "cem"), "between ann and cem"), ("network", ROBOTS, "loss 0.5, delay 0.001"),
    ]  # fmt: skip


def test_a_robot_is_frozen_until_it_continues_and_an_obstacle_moves() -> None:
    events = [
        {"at": 1, "freeze": "ann"},
        {"at": 2, "continue": "ann"},
        {"at": 3, "obstacle": {"number": 0, "by": [1, 0, 2]}},
    ]
    made = run(events=events)
    assert made.done == [
        (1.0, ("freeze", ("ann", math.inf))),
        (2.0, ("thaw", "ann")),
        (3.0, ("move", (0, (1.0, 0.0, 2.0)))),
    ]
    assert made.marks[2:] == [
        Cause(ZERO + 3, "obstacle", (), "number 0 by (1, 0, 2) m"),
        Moved(ZERO + 3, 0, Sphere(Point(1.0, 0.0, 2.0), 1.0)),
    ]  # fmt: skip


def test_an_obstacle_that_is_not_there_is_refused() -> None:
    schedule, _ = read({"events": [{"at": 3, "obstacle": {"number": 2, "by": [1, 0, 0]}}]}, ROBOTS)
    check_obstacles(schedule, 3)
    with pytest.raises(BadScenario, match="there is no obstacle 2") as raised:
        check_obstacles(schedule, 2)
    assert raised.value.hint == "they are numbered 0 to 1"


def test_an_open_schedule_takes_events_while_the_run_goes_on() -> None:
    made = FakeRun()
    faults = Faults(Schedule(), open=True)
    made.through(faults, 3.0)
    assert made.done == [(LAUNCH - ZERO, ("disturb", Medium()))], "the network can be disturbed later"
    schedule, _ = read({"events": [{"at": 3, "crash": "bob", "for": 2}]}, ROBOTS)
    faults.give(schedule.events[0], made.now)
    assert made.done[1:] == [(3.0, ("crash", "bob"))] and made.marks[0].t == ZERO + 3
    made.now += 2.0
    faults.step(made.now, [])
    assert made.done[2:] == [(5.0, ("restart", "bob"))]


def test_a_network_of_which_nothing_is_said_is_left_alone() -> None:
    assert run(events=[{"at": 2, "wind": {"mean": [1, 0, 0]}}]).done == [(2.0, ("blow", Wind((1.0, 0.0, 0.0))))]


def test_the_worlds_own_wind_comes_back() -> None:
    assert run(events=[{"at": 2, "for": 1, "wind": {"gust": 1}}]).done[-1] == (3.0, ("blow", Wind()))


def test_devices_are_upset_and_well_again() -> None:
    events = [
        {"at": 1, "for": 2, "positioning": {"robot": "bob", "noise": 0.5}},
        {"at": 1, "for": 2, "lag": {"robot": "cem", "seconds": 0.3}},
        {"at": 1, "battery": {"robot": "ann", "level": 0.25}},
    ]
    schedule, _ = read({"events": events}, ROBOTS)
    during, after = FakeRun(), FakeRun()
    during.through(Faults(schedule), 2.0)
    assert during.upsets[1].positioning.noise == 0.5 and during.upsets[2].lag == 0.3
    assert [fault_state.battery for fault_state in during.upsets] == [0.25, 1.0, 1.0]
    after.through(Faults(schedule), 4.0)
    assert (
        after.upsets[1].positioning == NO_POSITIONING_FAULT
        and after.upsets[2].lag == 0.0
        and after.upsets[0].battery == 0.25
    )


def test_flags_are_laid_over_the_file() -> None:
    schedule = Schedule(Conditions(loss=0.1, delay=0.02))
    assert with_network(schedule, {"loss": 0.3, "delay": None}).network == Conditions(loss=0.3, delay=0.02)
    assert with_network(Schedule(), {"loss": 0.3}).network == Conditions(loss=0.3)
    assert with_network(Schedule(), {"loss": None}) == Schedule()


def test_a_fault_after_the_end_is_refused() -> None:
    schedule, _ = read({"events": [{"at": 30, "crash": "ann"}]}, ROBOTS)
    check_times(schedule, 31.0)
    with pytest.raises(BadScenario, match="the crash at 30 s would come after the run's end, at 30 s"):
        check_times(schedule, 30.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"network": {"loss": 0.1}}', ""),
        ("network: {loss: 0.1}", r"1:1: invalid JSON"),
        ('{"network": \n {"loss": }}', r"2:11: invalid JSON"),
        ('{"events": [{"at": 1, "crash": "ann"}, {"at": 2, "crash": "zoe"}]}', r"events\[1\]\.crash: no robot 'zoe'"),
        ('{"network": {"loss": 2}, "links": 3}', r"network\.loss: .*\n.*links: links must be a list"),
        ("[]", "the scenario must be a mapping"),
        ("[" * 100_000, "recursion|nested"),
    ],
)
def test_a_bundle_takes_json(tmp_path: Path, text: str, said: str) -> None:
    file = tmp_path / "scenario.json"
    file.write_text(text)
    if not said:
        assert load(file, ROBOTS) == (Schedule(Conditions(loss=0.1)), json.loads(text))
        return
    with pytest.raises(BadScenario, match=said) as raised:
        load(file, ROBOTS)
    assert str(file) in str(raised.value)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(BadScenario, match="No such file"):
        load(tmp_path / "none.json", ROBOTS)


def test_what_is_written_for_a_bundle_is_what_it_reads(tmp_path: Path) -> None:
    data = {"events": [{"at": 1.5, "for": 2, "partition": [["ann"], ["bob"]]}]}
    (tmp_path / "s.json").write_text(json.dumps(data))
    assert load(tmp_path / "s.json", ROBOTS) == (read(data, ROBOTS)[0], data)


def test_a_bundle_takes_yaml_where_the_package_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "s.yaml"
    file.write_text("network: {loss: 0.1}\n")
    assert load(file, ROBOTS)[0] == Schedule(Conditions(loss=0.1))
    file.write_text("network: {loss: 0.1\n")
    with pytest.raises(BadScenario, match=r"invalid YAML(.|\n)*line 2"):
        load(file, ROBOTS)
    monkeypatch.setitem(sys.modules, "yaml", None)
    with pytest.raises(BadScenario, match="YAML needs the Python package PyYAML; JSON works without it"):
        load(file, ROBOTS)
