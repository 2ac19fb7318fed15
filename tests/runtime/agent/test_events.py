"""Events on a robot: faults and late events are discarded whole, `stop`, `reached`, the end of a mission."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from types import FrameType
from typing import Any

import pytest

from benchmarks.fixtures.fleet import FakePlatform, Fleet
from benchmarks.fixtures.lineform import PROGRAM, State, effect
from koordgen.runtime.agent.machine import WRONG_PROGRAM
from koordgen.runtime.program.program import Event, Program, Stopped, no_ports, wrong_first_value
from koordgen.runtime.program.runner import Interrupting, Overrun, Runner
from koordgen.runtime.values.clock import SystemClock
from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.platform import Sensed
from tests.build.emit.generated import load
from tests.runtime.replication.agents import locals_of
from tests.runtime.replication.reference import check_visibility


def program(effect: Callable[[State], None], guard: Callable[[State], bool] = lambda s: True) -> Program:
    return replace(PROGRAM, events=(Event("Only", 21, guard, effect),))


def half_done_then_raise(s: State) -> None:
    s.x.own = Point(9, 9, 9)
    s.last.value = 99
    s.target.value = Point(1, 1, 1)
    s.count.value = 99
    if s.pid == 2:
        raise ZeroDivisionError("division by zero")


def writes_nan(s: State) -> None:
    s.last.value = 7
    s.target.value = Point(float("nan"), 0, 0)


def writes_beyond_64_bits(s: State) -> None:
    s.last.value = 2**63


def reads_beyond(s: State) -> None:
    s.last.value = 7
    s.target.value = s.x[s.n_sys]


@pytest.mark.parametrize(
    ("effect", "reason"),
    [
        (half_done_then_raise, "lineform.koord: ZeroDivisionError: division by zero"),
        (writes_nan, "lineform.koord:21: Motion.target would become Point(x=nan"),
        (writes_beyond_64_bits, "lineform.koord:21: last would become an int beyond 64 bits"),
        (reads_beyond, "index 5 names no robot"),
    ],
)
def test_a_fault_discards_the_event_whole_and_holds(effect: Callable[[State], None], reason: str) -> None:
    fleet = Fleet(program=program(effect, lambda s: s.pid == 2)).boot_all()
    fleet.run_rounds(8)
    cleo = fleet.robots[2]
    assert all(r.effects is None and r.fault is not None for r in cleo.records)
    assert cleo.platform.held and not cleo.platform.commands
    assert locals_of(cleo) == {"count": 0}
    assert len([line for line in cleo.lines if reason in line]) == 1  # once, not once a round
    alice = fleet.robots[0].records[-1].frame
    assert alice is not None and alice.shared["last"] == 4  # as after init
    assert not fleet.robots[0].platform.held  # the others go on
    check_visibility(fleet)


def test_a_fault_in_a_guard_is_a_fault() -> None:
    def guard(s: State) -> bool:
        raise KeyError("here")

    fleet = Fleet(program=program(effect, guard)).boot_all()
    fleet.run_rounds(3)
    assert "KeyError" in str(fleet.robots[0].records[-1].fault)


def test_the_robot_goes_on_when_the_fault_is_over() -> None:
    def sometimes(s: State) -> None:
        if s.last.value > 1:
            s.count.value += 1
        elif s.position.x < 100:
            raise ValueError("early")

    fleet = Fleet(program=program(sometimes)).boot_all()
    fleet.run_rounds(3)
    assert locals_of(fleet.robots[0])["count"] > 0
    assert not fleet.robots[0].platform.held


def test_an_event_beyond_the_publish_deadline_never_happened() -> None:
    fleets: list[Fleet] = []

    def slow(s: State) -> None:
        effect(s)
        fleets[0].time.time += 0.06

    fleets.append(Fleet(program=program(slow, lambda s: s.pid == 1)).boot_all())
    fleets[0].run_rounds(6)
    bert = fleets[0].robots[1]
    assert bert.agent.counters()["discarded"] >= 5
    assert locals_of(bert) == {"count": 0} and not bert.platform.commands and bert.platform.held
    assert "lineform.koord:21: not finished by the round's publish deadline" in "".join(bert.lines)
    check_visibility(fleets[0])


def loops(s: State) -> None:
    while True:
        s.count.value += 1


def loops_and_catches(s: State) -> None:
    while True:
        try:
            loops(s)
        except Exception:
            continue


@pytest.fixture
def interrupting() -> Iterator[Interrupting]:
    before = signal.getsignal(signal.SIGALRM)
    yield Interrupting()
    signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("endless", [loops, loops_and_catches])
def test_an_event_that_never_ends_is_interrupted(endless: Callable[[State], None], interrupting: Interrupting) -> None:
    clock = SystemClock()
    runner = Runner(program(endless), 0, 1, clock, interrupting)
    sensors, actuators = {"Motion.position": Point(), "Motion.reached": True}, {"Motion.target": Point()}
    shared: dict[str, Any] = {"x": (Point(),), "last": 0}
    began = clock.now()
    outcome = runner.step(runner.frame(shared, sensors, actuators, no_ports), began + 0.03)
    assert outcome.event == "Only" and outcome.effects is None
    assert "publish deadline" in str(outcome.fault)
    assert clock.now() - began < 0.5
    assert runner.locals == {"count": 0}


def test_a_timer_that_rings_while_it_is_set_ends_with_its_event(
    monkeypatch: pytest.MonkeyPatch, interrupting: Interrupting
) -> None:
    """As on a busy host: the process is put off within the system call that starts the timer."""

    def put_off(which: int, seconds: float, again: float = 0.0) -> None:
        set_timer(which, seconds, again)
        until = time.monotonic() + 0.002
        while time.monotonic() < until:
            pass

    set_timer = signal.setitimer
    monkeypatch.setattr(signal, "setitimer", put_off)
    with pytest.raises(Overrun), interrupting(0.0):
        raise AssertionError("the event begins")
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


def test_a_timer_that_rings_when_the_event_is_over_changes_nothing(
    monkeypatch: pytest.MonkeyPatch, interrupting: Interrupting
) -> None:
    """At the first step of its end, which must not be kept from turning the timer off."""

    rung = 0

    def rings_as_it_is_left(frame: FrameType, what: str, argument: object) -> None:
        nonlocal rung
        if frame.f_code is Interrupting.__exit__.__code__ and what == "call":
            rung += 1
            interrupting._ring(signal.SIGALRM, frame)

    before = sys.getprofile()
    try:
        with interrupting(60.0):
            sys.setprofile(rings_as_it_is_left)
    finally:
        sys.setprofile(before)
    assert rung == 1 and signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


def stops_when_line_is_reached(s: State) -> None:
    s.last.value = s.pid
    if s.last.value >= 0:
        raise Stopped


def test_when_all_have_stopped_they_linger_and_rest() -> None:
    fleet = Fleet(program=program(stops_when_line_is_reached)).boot_all()
    fleet.run(30, until=lambda: all(r.agent.done for r in fleet.robots.values()))
    for robot in fleet.robots.values():
        assert robot.agent.done and robot.agent.status == 0
        assert robot.platform.stopped
        assert robot.records[0].effects is not None and robot.records[0].effects.stopped
        assert robot.records[1].skipped == "stopped"
        rests = [p for p in robot.trace("phase") if p["phase"] == "stopping"]
        assert rests[0]["detail"] == "all robots have stopped"
        lingered = [r for r in robot.trace("round") if r["time"] <= rests[0]["time"]]
        assert 20 <= len(lingered) <= 24
        assert [p["phase"] for p in robot.trace("phase") if not p["detail"]][-1] == "stopped"


def test_one_robot_that_stopped_freezes_nobody() -> None:
    def stop_one(s: State) -> None:
        effect(s)
        if s.pid == 2:
            raise Stopped

    fleet = Fleet(program=program(stop_one, lambda s: 0 < s.pid < 4)).boot_all()
    fleet.run_rounds(60)
    assert fleet.robots[2].platform.held
    assert fleet.robots[2].records[0].effects is not None
    assert all(r.skipped == "stopped" for r in fleet.robots[2].records[1:])
    assert all(r.event for r in fleet.robots[1].records) and not fleet.robots[1].platform.held
    check_visibility(fleet)


class Sticky(FakePlatform):
    """Says one and the same of `reached`, whatever it was commanded."""

    says = False

    def sense(self, now: float) -> Sensed:
        return Sensed({**super().sense(now).values, "Motion.reached": self.says}, self.seen)


def test_reached_is_true_before_any_command_and_never_stale_after_one() -> None:
    fleet = Fleet(n=3)
    body = Sticky(Point(1, 1, 0))
    fleet.boot(0)
    fleet.boot(1, body)
    fleet.boot(2)
    bert = fleet.robots[1]
    fleet.run_told(1)
    assert bert.records[0].sensors["Motion.reached"] is True
    body.says, body.fresh = True, False  # judged by a position that is older than the command
    body.seen = body.commands[0][0] - 0.01
    fleet.run(0.12)
    assert bert.records[1].sensors["Motion.reached"] is False
    body.fresh = True  # polled several times a round, so the next sample is younger than the command before it
    fleet.run(0.1)
    assert bert.records[2].sensors["Motion.reached"] is True


def test_actuators_begin_as_a_hold_and_read_back() -> None:
    fleet = Fleet(n=3).boot_all()
    fleet.run_rounds(3)
    first, second = (r.frame for r in fleet.robots[1].records[:2])
    assert first is not None and second is not None
    assert first.actuators == {"Motion.target": fleet.robots[1].records[0].sensors["Motion.position"]}
    effects = fleet.robots[1].records[0].effects
    assert effects is not None
    assert second.actuators == effects.actuators


def test_a_fault_in_init_ends_this_robot_before_the_mission() -> None:
    def init(s: State) -> None:
        raise ValueError("no such thing")

    fleet = Fleet(program=replace(PROGRAM, init=init), n=1).boot_all()
    fleet.run(10, until=lambda: fleet.robots[0].agent.done)
    assert fleet.robots[0].agent.status == 1
    assert fleet.robots[0].platform.stopped
    assert "ValueError: no such thing (in init)" in "".join(fleet.robots[0].lines)


def test_a_monitor_that_fails_is_dropped() -> None:
    fleet = Fleet(n=1).boot_all()

    def monitor(record: object) -> None:
        raise RuntimeError("oops")

    fleet.robots[0].agent._journal._monitors.append(monitor)
    fleet.run_rounds(5)
    assert len([line for line in fleet.robots[0].lines if "a monitor failed" in line]) == 1


def squares(s: State) -> None:
    s.count.value = max(s.count.value, 3) ** 2


def test_a_local_int_that_leaves_64_bits_is_a_fault() -> None:
    fleet = Fleet(program=program(squares, lambda s: s.pid == 2)).boot_all()
    fleet.run_rounds(9)
    cleo = fleet.robots[2]
    assert locals_of(cleo) == {"count": 3**32}
    assert "count would become an int beyond 64 bits" in str(cleo.records[-1].fault)


GROWS = """
local:
  float f = 1e300
  bool on
Grow:
  pre: {guard}
  eff:
    {effect}
"""


@pytest.mark.parametrize(
    ("guard", "effect", "rounds", "reason", "line"),
    [
        ("True", "f = f * 10", 8, "f would become inf, which no robot may use", 8),
        ("True", "f = f * 1e9 - f * 1e9", 0, "f would become nan, which no robot may use", 8),
        ("True", "on = f * 1e9 - f * 1e9 == 0", 0, "a comparison met NaN", 8),
        ("f * 1e9 - f * 1e9 == 0", "on = True", 0, "a comparison met NaN", 6),
    ],
)
def test_a_robot_keeps_no_nan_and_no_infinity(guard: str, effect: str, rounds: int, reason: str, line: int) -> None:
    fleet = Fleet(n=2, program=load(GROWS.format(guard=guard, effect=effect))).boot_all()
    fleet.run_rounds(12)
    for robot in fleet.robots.values():
        assert locals_of(robot) == {"f": pytest.approx(1e300 * 10**rounds), "on": False}
        assert str(robot.records[-1].fault) == f"a.koord:{line}: {reason}"


def test_a_variable_may_not_begin_with_infinity() -> None:
    """The compiler refuses such a first value; a bundle of another compiler may have one."""
    begins = load("local: List<float> fs = [1e308]\n" + GROWS.format(guard="True", effect="pass"))
    assert wrong_first_value(begins) is None
    (fs, *others) = begins.locals
    assert fs.name == "fs"
    changed = replace(begins, locals=(replace(fs, initial=lambda: (1e308 * 10,)), *others))
    assert wrong_first_value(changed) == "fs would begin as (inf,), which no robot may use"


def test_an_init_that_writes_more_than_can_be_sent_ends_the_robot_with_a_reason() -> None:
    """A bundle that was built without a fleet file knows the robots, and so the room, only now."""
    fleet = Fleet(n=2).boot_all()
    fleet.robots[0].agent._link.sender.room = 20
    fleet.run(3.0, until=fleet.robots[0].done)
    alice = fleet.robots[0]
    assert alice.agent.status == WRONG_PROGRAM and alice.platform.stopping is not None
    assert any("init writes" in line and "at most 20 can be sent" in line for line in alice.lines)
