"""Attack: contradictions found within its budget, no false alarm on correct programs, counts of states."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from koordgen.build.pipeline import check_file
from koordgen.lang.diagnostics import InternalError
from koordgen.verify.attack.attack import attack
from koordgen.verify.attack.judge import ENVIRONMENT, INIT, WELL_DEFINED, ReplayedTrial, TrialJudge
from koordgen.verify.prove.smt import term
from koordgen.verify.prove.smt.solve import Limits, Solver
from tests.programs import programs_alone
from tests.verify.attack.faults import FAULTS, attacked, broken, ticks
from tests.verify.prove.battery.battery import BATTERY
from tests.verify.prove.proving import checked

EXAMPLES = programs_alone()


@pytest.fixture(scope="module")
def solver() -> Iterator[Solver]:
    with Solver("z3", Limits(query=5.0, total=10_000.0)) as running:
        yield running


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("fault", FAULTS)
def test_a_forged_proof_is_contradicted_within_the_default_budget(fault: str, seed: int) -> None:
    assert broken(attacked(FAULTS[fault], seed=seed)) == "Q"


@pytest.mark.parametrize("name", BATTERY)
def test_what_is_proved_of_right_programs_is_never_contradicted(name: str, solver: Solver) -> None:
    text, proved = BATTERY[name]
    names = proved - {"vacuous"}
    for seed in range(2):
        found = attack(checked(text), names, solver=solver, clock=ticks(), seed=seed)
        assert found.contradiction is None
        assert not names or "vacuous" in proved or found.states or found.reasons


@pytest.mark.parametrize("seeds", (range(2), pytest.param(range(2, 10), marks=pytest.mark.slow)), ids=("two", "more"))
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_the_invariants_of_the_examples_are_never_contradicted(path: Path, seeds: range, solver: Solver) -> None:
    program = check_file(str(path)).program
    names = [WELL_DEFINED, *[p.name for p in program.properties if p.kind == "invariant"]]
    for seed in seeds:
        found = attack(program, names, solver=solver, clock=ticks(), seed=seed)
        assert found.contradiction is None
        assert found.states


def test_the_same_seed_gives_the_same_states() -> None:
    text = BATTERY["geofence"][0]
    first, again, other = (attacked(text, BATTERY["geofence"][1], seed=seed) for seed in (1, 1, 2))
    assert first.states == again.states
    assert first.states != other.states or first.seconds != other.seconds


def test_what_is_too_large_for_the_solver_is_attacked_without_it(
    solver: Solver, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(term, "MOST_STEPS", 20)
    text, proved = BATTERY["geofence"]
    found = attack(checked(text), proved, solver=solver, clock=ticks())
    assert found.contradiction is None
    assert found.states
    assert any("cannot be encoded" in reason for reason in found.reasons.values()), found.reasons


STALE = """
allread: bool busy[N_SYS]
Begin:
  pre: not True in busy
  eff:
    {atomic} busy[pid] = True
invariant Alone: forall i, j in ID: i == j or not (busy[i] and busy[j])
"""


def test_plain_events_read_the_store_of_the_rounds_start() -> None:
    assert broken(attacked(STALE.format(atomic="if True:"))) == "Alone"
    assert broken(attacked(STALE.format(atomic="atomic:"))) == ""


ORDER = """
allwrite: int last
local: int seen
Write:
  pre: pid == 1
  eff: last = 1
Look:
  pre: pid == 0
  eff: atomic:
    seen = last
    last = 0
invariant Q: forall i in ID: seen[i] == 0 and last < 2
"""


def test_the_robots_of_a_round_are_run_in_every_order() -> None:
    """Robot 0 sees what robot 1 wrote only where robot 1 comes first."""
    found = attacked(ORDER, robots=2)
    assert broken(found) == "Q"
    assert found.contradiction is not None and found.contradiction.after.robots[0].locals["seen"] == 1


MOVING = """
using Dev:
  sensors: int level
  assume level' {assumed} level
local: int a
Go:
  pre: a == 1
  eff: a = 2
initially: forall i in ID: Dev.level[i] == 4
invariant Q: forall i in ID: Dev.level[i] <= 4
"""


def test_the_environment_moves_as_the_assumptions_allow_and_not_otherwise() -> None:
    found = attacked(MOVING.format(assumed=">="))
    assert found.contradiction is not None and found.contradiction.trial.acts[-1].event == ENVIRONMENT
    quiet = attacked(MOVING.format(assumed="<="))
    assert quiet.contradiction is None and quiet.states[ENVIRONMENT, "Q"]


FAR = """
local: int n
Up:
  pre: n < 1000
  eff: n += 1
Jump:
  pre: n == 1000
  eff: n += 5
invariant Q: forall i in ID: n[i] <= 1000
"""


def test_the_solver_tells_states_that_no_short_run_comes_to(solver: Solver) -> None:
    assert broken(attacked(FAR)) == ""
    found = attacked(FAR, solver=solver, seconds=0.2)
    assert found.contradiction is not None and found.contradiction.breach.invariant == "Q"
    assert found.contradiction.trial.acts[-1].event == "Jump"


def test_invariants_that_are_not_proved_are_no_hypotheses(solver: Solver) -> None:
    """`Small` is false, and excludes the one state in which the step breaks `Q`."""
    text = FAR.replace("invariant Q", "invariant Small: forall i in ID: n[i] < 1000\ninvariant Q")
    assert broken(attacked(text, ["Q"], solver=solver, seconds=0.2)) == "Q"


PARAM = """
param int most = 5
local: int a
Go:
  pre: a < most and a < 9
  eff: a = most
initially: most >= 2
invariant Q: forall i in ID: a[i] <= {limit}
"""


def test_params_without_a_value_have_any_that_the_program_allows(solver: Solver) -> None:
    assert broken(attacked(PARAM.format(limit=5))) == "Q"
    fixed = checked(PARAM.format(limit=5)).params[0].default
    assert broken(attacked(PARAM.format(limit=5), params={"most": fixed}, solver=solver)) == ""
    low = PARAM.replace("a = most", "a = 0 - most").replace("a[i] <= {limit}", "a[i] <= 0 - 2 or a[i] == 0")
    assert broken(attacked(low, solver=solver)) == "", "`initially` bounds the param for good"


PLANNED = """
using Motion:
  sensors: Point position
  actuators: List<Point> path
  PathPlanner planner
  assume planner(goal) == [] or last(planner(goal)) == goal
local: List<Point> way max 8
Go:
  pre: len(way) == 0
  eff:
    way = Motion.planner(Point(1, 2, 3))
invariant Ends: forall i in ID: len(way[i]) == 0 or last(way[i]) == Point(1, 2, 3)
invariant Short: forall i in ID: len(way[i]) <= 2
"""


def test_planners_answer_what_the_assumptions_allow_and_nothing_else() -> None:
    assert broken(attacked(PLANNED, ["Ends"])) == ""
    assert broken(attacked(PLANNED, ["Short"])) == "Short"
    assert (
        broken(attacked(PLANNED.replace("  assume planner(goal) == [] or last(planner(goal)) == goal\n", ""), ["Ends"]))
        == ""
    )


def test_an_extern_function_gives_no_states_and_a_reason() -> None:
    text = """
extern fun half(int x) -> int
local: int a
Go:
  pre: a == 0
  eff: a = half(4)
invariant Q: forall i in ID: a[i] == 0
"""
    found = attacked(text)
    assert found.contradiction is None
    assert found.of("Go", "Q") == (0, "the result of the extern function half is unknown")
    assert found.of(INIT, "Q")[0] > 0


def test_a_spec_function_gives_no_states_and_a_reason() -> None:
    text = """
spec fun good(int x) -> bool
axiom Zero: good(0)
local: int a
Go:
  pre: a == 0
  eff: a = 0
invariant Q: forall i in ID: good(a[i])
"""
    found = attacked(text)
    assert found.contradiction is None
    assert found.of("Go", "Q") == (0, "good is a spec fun, which only axioms describe")


def test_an_event_that_never_runs_gives_no_states_and_a_reason(solver: Solver) -> None:
    text = """
local: int a
Go:
  pre: a == 1
  eff: a = 2
invariant Q: forall i in ID: a[i] == 0
"""
    assert attacked(text, solver=solver).of("Go", "Q") == (
        0,
        "no state satisfies the invariants and the guard, in a fleet of 1",
    )
    assert attacked(text, seconds=1.0).of("Go", "Q") == (0, "no state was found from which the step can be run")


def test_an_empty_budget_and_large_fleets_have_their_reasons() -> None:
    text = FAULTS["a value written before a loop"]
    assert attacked(text, seconds=0.0001).of("Go", "Q") == (0, "the budget of 0.1 ms was used up before")
    assert attacked(text, robots=5).of("Go", "Q") == (0, "only fleets of at most 4 robots are attacked")


def test_a_loop_that_turns_too_often_shows_nothing_and_ends() -> None:
    text = """
local: int a
Go:
  pre: a == 0
  eff:
    while a >= 0: a += 1
Other:
  pre: a == 0
  eff: a = 0
invariant Q: forall i in ID: a[i] == 0
"""
    found = attacked(text)
    assert found.contradiction is None
    assert found.of("Go", "Q") == (0, "each run of the event was abandoned after 2,000 turns of loops")
    assert found.of("Other", "Q")[0] > 0


def test_each_state_is_counted_once() -> None:
    text = """
local: bool on
Go:
  pre: not on
  eff: on = True
invariant Q: forall i in ID: on[i] or not on[i]
"""
    found = attacked(text, robots=1)
    assert found.states == {(INIT, "Q"): 1, ("Go", "Q"): 1, (INIT, WELL_DEFINED): 1, ("Go", WELL_DEFINED): 1}


def test_first_values_that_a_param_makes_impossible_are_no_error() -> None:
    text = """
param int n = 2
local: int a = 6 // n
Go:
  pre: a > 0
  eff: a = 0
invariant Q: forall i in ID: a[i] >= 0 or n < 0
"""
    assert broken(attacked(text)) == ""


def test_states_of_models_keep_first_values_of_what_no_model_tells(solver: Solver) -> None:
    text = FAR.replace("local: int n", "local:\n  int n\n  Set<int> seen max 4\n  Map<int, int> m max 4")
    assert broken(attacked(text, solver=solver, seconds=0.2)) == "Q"


def test_what_the_semantics_does_not_repeat_is_an_error_of_the_attack(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(TrialJudge, "replay", lambda judge, trial: ReplayedTrial((trial.state,), None))
    with pytest.raises(InternalError, match="the second run shows no contradiction"):
        attacked(FAULTS["a value written before a loop"])


LOOP = """
fun up(int n) -> int:
  int k = 0
  while k < n:
    invariant 0 <= k and k <= {most}
    k += 1
  return k
local: int a
Go:
  pre: a == 0
  eff:
    a = up(3)
    int j = 0
    while j < 3:
      invariant j >= 0
      j += 1
invariant Q: forall i in ID: a[i] <= 3
"""


def test_an_invariant_at_a_loop_is_judged_when_an_event_comes_to_it() -> None:
    names = ["line 4", "line 14", "Q"]
    found = attacked(LOOP.format(most=3), names)
    assert found.contradiction is None
    assert found.of("up", "line 4")[0] > 0 and found.of("Go", "line 14")[0] > 0
    assert broken(attacked(LOOP.format(most=2), names)) == "line 4"
    assert broken(attacked(LOOP.format(most=2), ["Q"])) == "", "it is not PROVED"
