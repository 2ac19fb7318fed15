"""Guarantees about a step, judged on the writes of a run."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

from koordgen.lang.semantics.composition import Application, System
from targets.sim.judging.guarantees import StepGuarantees, WatchedApplication
from targets.sim.judging.judge import all_of
from targets.sim.trace.truth import SharedWrite
from tests.composed.agents import fleet_program, properties_of
from tests.lang.semantics.compositions import compiled

FIRST = """\
export:
  write int n
    guarantee Grows: n <= n'
    guarantee Small: n < 9
  int x[N_SYS]
    guarantee Sum: sum(x) <= sum(x')
allwrite: int n
allread: int x[N_SYS]
Go:
  pre: n < 5
  eff: n += 1
"""
SECOND = "import First:\n  write int n\nGo:\n  pre: n > 5\n  eff: n = 0\n"


class Judged:
    """Judge of `first` on ann and bob; `second` runs on bob. `violations`: texts of all violations so far."""

    def __init__(self) -> None:
        first, second = compiled("first", FIRST), compiled("second", SECOND)
        bound = (("First", "first"),)
        system = System((Application("first", first, (0, 1)), Application("second", second, (1,), bound)), 2)
        fleet = fleet_program(system)
        found = properties_of(system)["first"]
        self.watched = all_of(found, 2, "first")
        self.steps = StepGuarantees(self.watched, found, WatchedApplication(fleet, 0, found), ("ann", "bob"))
        self.values: dict[str, Any] = {"n": 0, "x": [0, 0]}
        self.violations: list[str] = []
        self.round_([])

    def round_(
        self, writes: Sequence[tuple[str, Any, int]], lacking: Sequence[int] = (), removed: Sequence[int] = ()
    ) -> Judged:
        """Judge a round with writes: (variable, its new value, the writing instance)."""
        changes = []
        for name, value, instance in writes:
            changes.append(SharedWrite(name, self.values[name], value, instance, "Go"))
            self.values[name] = value
        truth: Any = SimpleNamespace(lacking=set(lacking), changes=changes, value=self.values.__getitem__)
        self.violations += [v.detail for v in self.steps.judge(truth, 0.1, set(removed))]
        return self


def test_only_variables_with_a_step_guarantee_are_compared() -> None:
    assert Judged().steps.variables == {"n", "x"}
    assert {w.name for w in Judged().watched if w.is_step} == {"Grows", "Sum"}


def test_each_write_of_a_round_is_judged() -> None:
    """The value at the round's end is larger than that at its start, but one write made it smaller."""
    judged = Judged().round_([("n", 3, 0), ("n", 1, 2)])
    assert judged.violations == ["guarantee first.Grows does not hold: n = 3; n' = 1; by Go of second on bob"]
    (grows,) = [w for w in judged.watched if w.name == "Grows"]
    assert grows.robots == ("bob",) and grows.outcome == "violated"


def test_slots_are_compared_as_a_whole() -> None:
    judged = Judged().round_([("x", [4, 0], 0), ("x", [4, 1], 1)])
    assert not judged.violations
    assert judged.round_([("x", [0, 1], 0)]).violations[0].endswith("by Go of first on ann")


def test_a_variable_that_does_not_change_keeps_its_guarantee() -> None:
    judged = Judged().round_([]).round_([("n", 1, 0)])
    verdicts = {w.name: w.verdict(1.0, 0.0, "") for w in judged.watched}
    assert (verdicts["Grows"].outcome, verdicts["Grows"].observations) == ("held", 2)
    assert (verdicts["Sum"].outcome, verdicts["Sum"].observations) == ("held", 2)


def test_a_round_without_a_record_is_judged_with_the_next_complete_one() -> None:
    """A write may lack between two known ones, and a slot may be older than the others."""
    judged = Judged().round_([("n", 4, 0)]).round_([("n", 2, 0)], lacking=[2])
    assert not judged.violations
    assert not judged.round_([("n", 5, 0)]).violations, "from 4 to 5"
    judged.round_([], lacking=[1]).round_([("n", 1, 0)])
    assert judged.violations[0].endswith("n = 5; n' = 1; by writes of several rounds, not all of which were recorded")


def test_a_removed_robot_has_no_records_that_could_lack() -> None:
    judged = Judged().round_([("n", 4, 0)]).round_([("n", 2, 0)], lacking=[1, 2], removed=[1, 2])
    assert len(judged.violations) == 1


def test_init_need_not_keep_a_guarantee_about_a_step() -> None:
    judged = Judged()
    judged.steps._last = None
    assert not judged.round_([("n", -1, 0)]).violations
