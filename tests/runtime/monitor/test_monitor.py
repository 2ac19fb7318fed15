"""A robot's own monitors: what it can tell, how old that is, what it does about it, what it must not cost."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from types import ModuleType
from typing import Any

import pytest

from benchmarks.fixtures.fleet import settings
from koordgen.build.emit.program import program_text
from koordgen.build.emit.property import properties_text
from koordgen.runtime.monitor.monitor import LONGEST_WAIT, MOST_OVERRUNS, CpuBudget, Monitors
from koordgen.runtime.program.extern import Contract
from koordgen.runtime.program.program import Effects, Fault, Frame
from koordgen.runtime.program.property import Properties
from koordgen.runtime.program.runner import LEFT, Limit, Overrun, unlimited
from koordgen.runtime.trace.monitored import OWN, SENSED, SHARED, Change, Observation
from koordgen.runtime.trace.writer import RoundRecord
from koordgen.runtime.values.points import Point
from tests.build.emit.generated import checked

TEXT = """\
using Motion:
  sensors:
    Point position
    bool reached
  actuators: Point target
  PathPlanner planner
  assume position' in Rect(position, target)
  assume not reached or reached'
  assume planner(goal) == [] or last(planner(goal)) == goal
local: int count
allread: int x[N_SYS]
allwrite: int most
E:
  pre: True
  eff: pass
invariant Low: forall i in ID: Motion.position[i].z < 2
invariant Counted: forall i in ID: count[i] < 5
invariant Bounded: forall i in ID: x[i] <= most
invariant Sum: 10 / most > sum(x)
"""


def generated(text: str) -> Properties:
    program = checked(text)
    for name, code in (("program", program_text(program)), ("properties", properties_text(program))):
        module = sys.modules[name] = ModuleType(name)
        module.__file__ = f"{name}.py"
        exec(compile(code, f"{name}.py", "exec"), vars(module))
    found: Properties = vars(sys.modules["properties"])["PROPERTIES"]
    return found


FOUND = generated(TEXT)


class Robot:
    """Robot 1 of three, whose monitors are asked round by round."""

    def __init__(self, limit: Limit = unlimited, cpu: Any = None, **monitors: str) -> None:
        self.changes: list[Change] = []
        given = settings(1, 3, monitors={name.replace("_", " "): action for name, action in monitors.items()})
        self.monitors = Monitors(FOUND, given, self.changes.append, limit, cpu)

    def look(self, round_: int, certain: int = SHARED, old: float = 0.0, **values: Any) -> None:
        """A moment; what is not said is as it should be."""
        position = values.get("position", Point(z=0.001 * round_))
        sensors = {"Motion.position": position, "Motion.reached": True}
        shared = {"x": values.get("x", (1, 1, 1)), "most": values.get("most", 1)}
        own, time = {"count": values.get("count", 0)}, 0.1 * round_
        self.monitors.look(
            Observation(round_, time, certain, time - old, sensors, own, shared, {"Motion.target": Point()})
        )  # fmt: skip

    def demands(self) -> str:
        return self.monitors.verdict.action

    def outcomes(self) -> dict[str, str | None]:
        return {watched.name: watched.outcome for watched in self.monitors.watched if watched.of == "invariant"}

    def told(self, name: str) -> list[tuple[int, str, int]]:
        return [(c.round, c.outcome, c.age) for c in self.changes if c.name == name]


def test_of_others_it_knows_nothing_but_its_own_violation_is_one() -> None:
    robot = Robot()
    robot.look(1)
    assert robot.outcomes() == {"Low": "unknown", "Counted": "unknown", "Bounded": "held", "Sum": "held"}
    robot.look(2, position=Point(z=3.0))
    assert robot.outcomes()["Low"] == "violated"
    low = robot.changes[-1]
    assert (low.of, low.name, low.line, low.age, low.action) == ("invariant", "Low", "a.koord:16", 0, "log")
    assert "i = 1 (bert)" in low.why and "Motion.position[1] = (0, 0, 3)" in low.why
    robot.look(3)
    assert robot.told("Low") == [(1, "unknown", 0), (2, "violated", 0), (3, "unknown", 0)]


def test_of_the_store_it_knows_all() -> None:
    robot = Robot()
    robot.look(1)
    robot.look(2, x=(1, 1, 4))
    assert robot.told("Bounded") == [(1, "held", 0), (2, "violated", 0)]
    assert "x[2] = 4; most = 1" in robot.changes[-1].why
    robot.look(3, most=0)
    assert robot.told("Sum")[-1] == (3, "no value", 0) and "division by zero" in robot.changes[-1].why


def test_what_is_not_certain_grows_old_and_is_not_known_at_last() -> None:
    robot = Robot()
    robot.look(1)
    for round_ in range(2, 30):
        robot.look(round_, SENSED, x=(9, 9, 9), position=Point(z=3.0 if round_ == 20 else 1.0))
    assert robot.told("Bounded") == [(1, "held", 0), (12, "unknown", 11)], "peer_timeout is 10 rounds"
    assert robot.changes[-1].name == "Low", "what it senses it knows all the time"
    assert robot.told("Low")[1:] == [(20, "violated", 0), (21, "unknown", 0)]
    assert robot.told("Counted") == [(1, "unknown", 0)]
    robot.look(30, OWN, count=7)
    assert robot.told("Counted")[-1] == (30, "violated", 0)
    robot.look(31)
    assert robot.told("Bounded")[-1] == (31, "held", 0)


def test_old_sensors_make_an_old_verdict() -> None:
    robot = Robot()
    robot.look(4, old=0.35, position=Point(z=3.0))
    assert robot.told("Low") == [(4, "violated", 3)]


def test_what_no_program_may_see_is_not_known() -> None:
    robot = Robot()
    robot.look(1, position=Point(z=float("nan")))
    assert robot.told("Low") == [(1, "unknown", 0)]


def test_only_what_reads_something_new_is_evaluated(monkeypatch: pytest.MonkeyPatch) -> None:
    robot, asked = Robot(), list[Any]()
    x, where = (1, 1, 1), Point()

    def judge(holds: Any, known: Any) -> Any:
        asked.append(holds)
        return "held", ""

    monkeypatch.setattr("koordgen.runtime.monitor.monitor.judged", judge)
    robot.look(1, x=x, position=where)
    assert len(asked) == 4
    robot.look(2, x=x, position=where)
    assert len(asked) == 4
    robot.look(3, x=(1, 0, 1), position=where)
    assert len(asked) == 6
    assert all(watched.true == 3 for watched in robot.monitors.watched if watched.of == "invariant")


def test_actions() -> None:
    robot = Robot(Low="hold", Bounded="stop", Counted="off")
    robot.look(1)
    assert robot.demands() == "go" and "Counted" not in robot.outcomes()
    robot.look(2, position=Point(z=3.0))
    assert robot.demands() == "hold"
    robot.look(3)
    assert robot.demands() == "go", "it goes on when its own part is right again"
    robot.look(4, x=(2, 1, 1))
    robot.look(5)
    assert robot.demands() == "stop", "for good"
    assert "invariant Bounded (a.koord:18) is violated" in robot.monitors.verdict.reason


def test_it_holds_while_nobody_knows_better() -> None:
    robot = Robot(default="hold")
    robot.look(1, x=(9, 1, 1))
    for round_ in range(2, 20):
        robot.look(round_, SENSED)
    assert robot.told("Bounded")[-1][1] == "unknown" and robot.demands() == "hold"
    robot.look(20)
    assert robot.demands() == "go"


def record(round_: int, position: Point, reached: bool = True, **more: Any) -> RoundRecord:
    sensors = {"Motion.position": position, "Motion.reached": reached}
    frame = Frame(1, 3, {}, {}, sensors, {"Motion.target": more.pop("target", Point())})
    return RoundRecord(round_, 0.1 * round_, 0.0, sensors, more.pop("frame", frame), **more)


def moved(target: Point) -> Mapping[str, Any]:
    return {"event": "E", "effects": Effects({}, {}, {"Motion.target": target}, False)}


def test_assumptions_are_about_the_way_from_an_event_to_the_next_rounds_sensors() -> None:
    robot, goal = Robot(), Point(4.0)
    robot.monitors.hear(record(1, Point(), **moved(goal)))
    robot.monitors.hear(record(2, Point(1.0), False, target=goal))
    assert [(c.name, c.outcome) for c in robot.changes] == [("Motion", "held")] * 3, "a new target is not reached"
    robot.monitors.hear(record(3, Point(1.0, 0.5), False, target=goal))
    assert [(c.line, c.outcome, c.round) for c in robot.changes[3:]] == [("a.koord:7", "violated", 0)]
    assert "Motion.position' = (1, 0.5, 0)" in robot.changes[-1].why
    robot.monitors.hear(record(5, Point(9.0), target=goal))
    robot.monitors.hear(record(6, Point(99.0), target=goal, frame=None, skipped=LEFT))
    assert len(robot.changes) == 4, "neither over a round that is missing nor of a robot that has left"
    calls = (("Motion.planner", (goal,), (Point(), Point(3.0))),)
    robot.monitors.hear(record(7, Point(4.0), target=goal, calls=calls))
    robot.monitors.hear(record(8, Point(4.0), target=goal))
    assert [(c.line, c.outcome) for c in robot.changes[4:]] == [("a.koord:7", "held"), ("a.koord:9", "violated")]


def test_a_broken_contract_is_told_until_its_event_runs_through() -> None:
    robot = Robot(requires_plan="stop")
    contract = Contract("requires", "plan", 3)
    fault = Fault("a.koord", 12, "plan was called although ...", contract)
    robot.monitors.hear(record(1, Point(), event="E", skipped="fault", fault=fault))
    robot.monitors.hear(record(2, Point(), skipped="no event enabled"))
    found = robot.changes[0]
    assert (found.of, found.name, found.line, found.outcome, found.action) == (
        "requires", "plan", "a.koord:3", "violated", "stop"
    )  # fmt: skip
    assert "a.koord:12" in found.why and robot.demands() == "stop"
    robot.monitors.hear(record(3, Point(), **moved(Point())))
    assert [c.outcome for c in robot.changes if c.of == "requires"] == ["violated", "held"]


def ran(*violated: int) -> Mapping[str, Any]:
    return {"event": "E", "effects": Effects({}, {}, {}, False, (), violated)}


def test_a_false_loop_invariant_is_told_until_its_event_runs_through() -> None:
    robot = Robot(loop_invariants="hold")
    robot.monitors.hear(record(1, Point(), **ran(14, 15)))
    found = [change for change in robot.changes if change.of == "loop invariant"]
    assert [(c.name, c.line, c.outcome, c.round, c.action) for c in found] == [
        ("line 14", "a.koord:14", "violated", 0, "hold"), ("line 15", "a.koord:15", "violated", 0, "hold")
    ]  # fmt: skip
    assert found[0].why == "in the event E it was false or had no value" and robot.demands() == "hold"
    robot.monitors.hear(record(2, Point(), skipped="no event enabled"))
    robot.monitors.hear(record(3, Point(), event="F", effects=Effects({}, {}, {}, False)))
    assert robot.demands() == "hold", "another event says nothing of it"
    robot.monitors.hear(record(4, Point(), **ran(15)))
    robot.monitors.hear(record(5, Point(), **ran()))
    told = [(c.name, c.outcome) for c in robot.changes if c.of == "loop invariant"]
    assert told[2:] == [("line 14", "held"), ("line 15", "held")] and robot.demands() == "go"
    assert "loop invariant line 14 (a.koord:14)" in robot.monitors.summary()[1]


def test_loop_invariants_of_init_and_those_that_are_off() -> None:
    robot = Robot()
    robot.monitors.ran(Effects({}, {}, {}, False, (), (9,)), None, 0, 0.0)
    assert [(c.name, c.why) for c in robot.changes] == [("line 9", "in init it was false or had no value")]
    silent = Robot(loop_invariants="off")
    silent.monitors.ran(Effects({}, {}, {}, False, (), (9,)), None, 0, 0.0)
    assert not silent.changes and not silent.monitors.summary()[0]


def test_what_takes_too_long_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    slow = FOUND.properties[0].holds

    @contextmanager
    def interrupted() -> Any:
        yield

    def judge(holds: Any, known: Any) -> Any:
        if holds is slow:
            raise Overrun
        return "held", ""

    def limit(seconds: float) -> AbstractContextManager[None]:
        assert seconds == pytest.approx(0.01)
        return nullcontext()

    monkeypatch.setattr("koordgen.runtime.monitor.monitor.judged", judge)
    robot = Robot(limit)
    for round_ in range(1, MOST_OVERRUNS + 3):
        robot.look(round_)
    assert robot.told("Low") == [(MOST_OVERRUNS + 1, "no value", MOST_OVERRUNS + 1)]
    assert robot.told("Sum")[0][1] == "held", "the others have their turn"


def test_only_so_much_of_the_processors_time_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]

    def cpu() -> float:
        now[0] += 1e-7
        return now[0]

    def judge(holds: Any, known: Any) -> Any:
        now[0] += 5e-6
        return "held", ""

    monkeypatch.setattr("koordgen.runtime.monitor.monitor.judged", judge)

    robot = Robot(cpu=cpu, Low="hold")
    evaluated = 0
    for round_ in range(1, 401):
        before = {w.name: w.true for w in robot.monitors.watched}
        robot.look(round_, x=(1, round_, 1), most=1000)
        now[0] += 5e-4  # what else the agent does in a round
        after = {w.name: w.true for w in robot.monitors.watched if w.of == "invariant"}
        assert after["Low"] == round_, "one with an action is evaluated always"
        evaluated += sum(after[name] != before[name] for name in ("Bounded", "Sum"))
    assert 50 < evaluated < 500, "1.5 % of 0.5 ms, less what Low takes"
    ages = [400 - w.true for w in robot.monitors.watched if w.of == "invariant"]
    assert max(ages) <= LONGEST_WAIT, "none waits for ever"


def test_an_allowance_is_a_share_of_what_else_was_done() -> None:
    now = [0.0]
    allowance = CpuBudget(lambda: now[0], 0.1)
    found = []
    for others, own in ((0.0, 0.0), (0.004, 0.0), (0.0, 0.0005), (1.0, 0.0009), (1.0, 0.0011)):
        now[0] += others
        allowance.begin()
        now[0] += own
        found.append(allowance.spent)
        allowance.end()
    assert found == [True, False, True, False, True], "no more than a millisecond is saved up"


def test_status_and_summary() -> None:
    robot = Robot()
    robot.look(1)
    robot.look(2, x=(5, 1, 1))
    report = robot.monitors.report()
    assert report["counts"] == {"unknown": 5, "held": 1, "violated": 1}
    (found,) = report["violated"]
    assert (found["name"], found["line"], found["since"], found["age"]) == ("Bounded", "a.koord:18", 2, 0)
    assert robot.monitors.summary() == (
        True, "5 unknown, 1 violated, 1 held; violated: invariant Bounded (a.koord:18)"
    )  # fmt: skip


def test_a_program_without_properties_costs_nothing() -> None:
    monitors = Monitors(None, settings(0, 1), lambda change: None, unlimited)
    assert not monitors.wanted and monitors.summary() == (False, "") and monitors.report()["counts"] == {}
