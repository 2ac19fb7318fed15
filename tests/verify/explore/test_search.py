"""Search: violations found, limits reached, and texts of results."""

from __future__ import annotations

import json

import pytest

from koordgen.lang.ir.decl import Program
from koordgen.lang.source import Source, Span
from koordgen.runtime.values.points import Point
from koordgen.verify.explore.breadth_first import ExplorationBounds
from koordgen.verify.explore.environment import STRAIGHT, Environment, MissingEnvironment, SensorDomain
from koordgen.verify.explore.environment_file import environment
from koordgen.verify.explore.search import DEADLOCK, WELL_DEFINED
from koordgen.verify.explore.show import document, itf, report, trace
from koordgen.verify.prove.report.trace import RunOrigin
from koordgen.verify.prove.report.verdict import Question, prove
from koordgen.verify.prove.smt.solve import Solver
from tests.lang.semantics.programs import compiled
from tests.verify.explore.reference import explored, search

COUNT = """
allread: int n[N_SYS]
Up:
  pre: n[pid] < 3
  eff: n[pid] = n[pid] + 1
Never:
  pre: n[pid] > 5
  eff: stop
invariant Small: forall i in ID: n[i] <= 3
"""
LOST = """
allwrite: int added
allread: bool done[N_SYS]
Add:
  pre: not done[pid]
  eff:
    added += 1
    done[pid] = True
Finish:
  pre: done[pid]
  eff: stop
invariant Counted: added == done.count(True)
"""
STALE = """
allwrite: int n
local: float x
Up:
  pre: n < 3
  eff: atomic:
    n += 1
Bad:
  pre: n > 0
  eff: atomic:
    x = 1 / (n - 2)
"""
LAMP = """
using Lamp:
  sensors: bool lit
  assume {assumed}
local: bool seen
See:
  pre: Lamp.lit and not seen
  eff: seen = True
Stop:
  pre: seen
  eff: stop
initially: forall i in ID: not Lamp.lit[i]
invariant Dark: forall i in ID: not Lamp.lit[i]
"""
LIT = Environment({"Lamp.lit": SensorDomain((False, True))}, {})


def names(run_states: object) -> list[tuple[int, str, int | None]]:
    return [(m.round, m.event, m.pid) for m in run_states]  # type: ignore[attr-defined]


def test_a_lost_update_is_found_in_one_round_of_two_robots() -> None:
    program = compiled(LOST)
    _, result = explored(program, 3)
    found = result.violation
    assert found is not None and found.name == "Counted" and found.failed is not None
    assert names(found.run_states) == [(0, "", None), (0, "init", None), (1, "Add", 0), (1, "Add", 1)]
    shown = report(result, program, "t.koord", 3)
    assert "Counted is violated after 1 round" in shown and "Add of robot 1" in shown and "(t.koord:12)" in shown
    assert all(len(line) <= 100 for line in shown.splitlines())


def test_who_waits_for_ever_without_having_stopped_is_in_a_deadlock() -> None:
    _, result = explored(compiled(COUNT), 2)
    found = result.violation
    assert found is not None and found.name == DEADLOCK and found.run_states[-1].round == 3
    _, result = explored(compiled(COUNT), 2, deadlock=False)
    assert result.violation is None and not result.stopped and [e.name for e in result.unseen] == ["Never"]
    assert result.progress.states == 16 - 6  # who is who makes no difference
    assert explored(compiled(COUNT), 2, deadlock=False, symmetry=False)[1].progress.states == 16


def test_an_event_without_a_result_is_found_with_what_it_read_within_the_round() -> None:
    for symmetry, independence in ((True, True), (False, True), (True, False)):
        _, result = explored(compiled(STALE), 3, symmetry=symmetry, independence=independence)
        found = result.violation
        assert found is not None and found.name == WELL_DEFINED and "Bad of robot" in found.reason
        assert [m.event for m in found.run_states] == ["", "init", "Up", "Up"] and found.run_states[-1].round == 1
        assert found.line == 11


GROWING = """
local:
  float f = 1e305
  bool on
Grow:
  pre: f == f
  eff:
    float g = f
    on = {met}
    f = {kept}
invariant Itself: forall i in ID: f[i] == f[i]
"""


@pytest.mark.parametrize(
    ("met", "kept", "rounds", "reason", "line"),
    [
        ("f - f == 0", "f * 10", 3, "f would become inf, which no robot may use", 10),
        ("True", "f * 1e9 - f * 1e9", 0, "f would become nan, which no robot may use", 10),
        ("g * 1e9 - f * 1e9 < 1", "1", 0, "a comparison met NaN", 9),
    ],
)
def test_nan_and_infinity_are_never_kept(met: str, kept: str, rounds: int, reason: str, line: int) -> None:
    """`f == f` is proved: on robots it was false from 1e308 on, when they kept what came of that."""
    program = compiled(GROWING.format(met=met, kept=kept))
    found = explored(program, 2)[1].violation
    assert found is not None and found.name == WELL_DEFINED and reason in found.reason
    assert (found.run_states[-1].round, found.line) == (rounds, line)
    with Solver("z3") as solver:
        verdicts = {v.invariant: v.verdict for v in prove(Question(program), solver)}
    assert verdicts["Itself"] == "PROVED"


def test_an_invariant_in_which_a_comparison_meets_nan_does_not_hold() -> None:
    program = compiled("local: float f = 1e308\nE:\n  pre: False\n  eff: pass\ninvariant P: f[0] * 9 - f[0] * 9 == 0\n")
    found = explored(program, 1)[1].violation
    assert found is not None and found.name == "P"


def test_the_environment_may_end_a_wait() -> None:
    may, never = compiled(LAMP.format(assumed="True")), compiled(LAMP.format(assumed="lit' == lit"))
    found = explored(may, 2, LIT)[1].violation
    assert found is not None and found.name == "Dark" and found.run_states[-1].event == "(environment)"
    found = explored(never, 2, LIT)[1].violation
    assert found is not None and found.name == DEADLOCK and found.run_states[-1].event == "init"
    free = compiled(LAMP.format(assumed="True").rpartition("invariant")[0])
    result = explored(free, 2, LIT)[1]
    assert result.violation is None and not result.stopped


def test_an_assumption_that_leaves_no_value_is_no_proof() -> None:
    program = compiled(LAMP.format(assumed="lit' != lit and lit' == lit"))
    result = explored(program, 1, LIT, deadlock=False)[1]
    assert result.violation is None and "no value" in result.stopped


def test_what_initially_excludes_all_is_no_proof() -> None:
    program = compiled(COUNT + "initially: forall i in ID: n[i] == 1\n")
    result = explored(program, 1)[1]
    assert result.violation is None and "initially" in result.stopped


@pytest.mark.parametrize("bounds, stopped, depth", [
    (ExplorationBounds(rounds=2), "the limit of 2 rounds", 2),
    (ExplorationBounds(states=5), "the limit of 5 states", 1),
    (ExplorationBounds(seconds=0.01), "the time limit of 0.01 s", 1),
])  # fmt: skip
def test_a_bound_is_told(bounds: ExplorationBounds, stopped: str, depth: int) -> None:
    program = compiled(COUNT)
    _, result = explored(program, 3, bounds=bounds, deadlock=False)
    assert result.violation is None and (result.stopped, result.progress.depth) == (stopped, depth)
    assert f"explored to depth {depth}" in report(result, program, "t.koord", 3)
    told = document(result, program, 3)
    assert (told["verdict"], told["complete"], told["stopped"]) == ("INCONCLUSIVE", False, stopped)


def test_an_interrupted_search_tells_how_far_it_came() -> None:
    made = search(compiled(COUNT), 2, deadlock=False)
    whole, rounds = made.rounds.ends, []

    def interrupted(fleet: tuple[int, ...]) -> object:
        rounds.append(fleet)
        if len(rounds) == 4:
            raise KeyboardInterrupt
        return whole(fleet)

    made.rounds.ends = interrupted  # type: ignore[method-assign, assignment]
    result = made.run()
    assert result.stopped == "interrupted" and result.progress.depth == 2 and result.progress.states > 3


def test_a_violation_is_a_trace_and_an_itf_document() -> None:
    program = compiled(LOST)
    found = explored(program, 2)[1].violation
    assert found is not None
    lines = [json.loads(line) for line in trace(found, program, RunOrigin()).splitlines()]
    assert lines[0]["kind"] == "header" and (lines[-1]["name"], lines[-1]["t"]) == ("Counted", 1.0)
    assert [r["event"] for r in lines if r["kind"] == "round" and r["pid"] == 0] == [None, "init", "Add", None]
    document = json.loads(itf(found, program))
    assert document["#meta"]["format"] == "ITF" and set(document["vars"]) <= set(document["states"][0])
    assert document["states"][-1]["added"] == {"#bigint": "1"}
    assert document["states"][-1]["done"] == {"#map": [[{"#bigint": "0"}, True], [{"#bigint": "1"}, True]]}


MOTION = """
using Motion:
  sensors:
    Point position
    bool reached
  actuators: Point target
  PathPlanner planner
local: bool sent
Go:
  pre: not sent
  eff:
    sent = len(Motion.planner(Motion.position)) > 0
"""


def read(program: Program, text: str | None) -> tuple[Environment | None, list[tuple[str, str, Span, str]]]:
    found: list[tuple[str, str, Span, str]] = []
    source = None if text is None else Source("env.yaml", text)
    return environment(program, 2, source, lambda *mistake: found.append(mistake)), found


def test_an_environment_is_read() -> None:
    grid = "{grid: {lo: [0, 0, 0], hi: [1, 2, 0], step: 0.5}, moves: 1}"
    around, found = read(compiled(MOTION), f"Motion.position: {grid}\nMotion.planner: straight\n")
    assert around is not None and not found and around.answers == {"Motion.planner": (STRAIGHT,)}
    values, near, *_ = around.domains["Motion.position"]
    assert len(values) == 3 * 5 and Point(0.5, 1.5, 0.0) in values and near is not None
    assert near(Point(0, 0, 0), Point(0.5, 0.5, 0)) and not near(Point(0, 0, 0), Point(1, 0, 0))
    assert around.domains["Motion.reached"].values == (False, True)
    around, found = read(compiled(MOTION), "Motion.position: [[0, 0, 0], [1, 2, 3]]\nMotion.planner: none\n")
    assert around is not None and around.domains["Motion.position"].values == (Point(0, 0, 0), Point(1, 2, 3))


@pytest.mark.parametrize(
    "text, lacking", [(None, "Motion.position"), ("Motion.position: [[0, 0, 0]]", "Motion.planner")]
)
def test_ports_without_values_are_named(text: str | None, lacking: str) -> None:
    with pytest.raises(MissingEnvironment, match=f"^{lacking} needs .*--env"):
        read(compiled(MOTION), text)


@pytest.mark.parametrize("text, code, line", [
    ("Motion.position: 3", "F004", 1),
    ("\nMotion.positon: [[0, 0, 0]]", "F002", 2),
    ("Motion.position: [[0, 0]]", "F004", 1),
    ("Motion.position: {grid: {lo: [0, 0, 0], hi: [1000, 1000, 0], step: 0.1}}", "F005", 1),
    ("Motion.position: {grid: {lo: [0, 0, 0], hi: [-1, 0, 0], step: 1}}", "F005", 1),
    ("Motion.position: {grid: {lo: [0, 0, 0], hi: [1, 0, 0]}}", "F003", 1),
    ("Motion.position: {grid: {lo: [0, 0, 0], hi: [1, 0, 0], step: 1}, moves: fast}", "F004", 1),
    ("Motion.planner: curved", "F005", 1),
    ("Motion.reached: {grid: {lo: [0, 0, 0], hi: [1, 0, 0], step: 1}}", "F004", 1),
    ("Motion.position: []", "F005", 1),
    ("a: b: c", "F001", 1),
])  # fmt: skip
def test_mistakes_in_an_environment_are_told_at_their_place(text: str, code: str, line: int) -> None:
    around, found = read(compiled(MOTION), text)
    assert around is None and [(f[0], f[2].line) for f in found] == [(code, line)]


def test_a_bound_holds_within_a_round_of_many_ends() -> None:
    values = tuple(range(20))
    text = "using Dev:\n  sensors: int level\nlocal: int n\nUp:\n  pre: n < 9\n  eff: n += Dev.level\n"
    program = compiled(text + "initially: forall i in ID: Dev.level[i] == 5\n")  # one state, then 1,600 in one round
    around = Environment({"Dev.level": SensorDomain(values)}, {})
    result = explored(program, 2, around, bounds=ExplorationBounds(states=450), symmetry=False)[1]
    assert result.stopped == "the limit of 450 states" and result.progress.states <= 450 + 20 * 20


FOLD = """
allwrite: int total
local:
  List<int> xs max 4
  int turn
{init}Grow:
  pre: turn < 2
  eff:
    for i in range(turn):
      invariant turn < 2
      xs.append(i)
    turn += 1
Sum:
  pre: turn == 2
  eff: atomic:
    for i in range(len(xs)):
      invariant i < {most}
      total += xs[i] + 1
    turn = 3
Stop:
  pre: turn == 3
  eff: stop
"""


def test_a_false_loop_invariant_is_a_violation_with_the_step_in_which_it_was_false() -> None:
    program = compiled(FOLD.format(init="", most="len(xs)"))
    for symmetry, independence in ((True, True), (False, True), (True, False)):
        _, result = explored(program, 2, symmetry=symmetry, independence=independence)
        found = result.violation
        assert found is not None and (found.name, found.line, found.failed) == ("line 17", 17, None)
        events = [(0, ""), (0, "init"), (1, "Grow"), (2, "Grow"), (3, "Sum")]
        assert [(m.round, m.event) for m in found.run_states] == events
        assert found.run_states[-1].state.store.cells["total"] == 1, "the event has its effects all the same"
        assert "line 17 is false or has no value in Sum of robot" in found.reason
    shown = report(result, program, "t.koord", 2)
    assert "the loop invariant on line 17 is violated after 3 rounds" in shown and "(t.koord:17)" in shown
    assert document(result, program, 2)["violation"]["what"] == "line 17"


def test_loop_invariants_that_hold_are_no_violation() -> None:
    result = explored(compiled(FOLD.format(init="", most="5")), 2)[1]
    assert result.violation is None and not result.stopped


def test_a_loop_invariant_of_init() -> None:
    init = "init:\n  for i in ID:\n    invariant i < 1\n    turn = 0\n"
    found = explored(compiled(FOLD.format(init=init, most="5")), 2)[1].violation
    assert found is not None and found.name == "line 8" and [m.event for m in found.run_states] == ["", "init"]
