"""Judge of attacks: faults that contradict `(well-defined)`, and trials that it rejects."""

from __future__ import annotations

from typing import Any

import pytest

from koordgen.lang.semantics.exact import exact
from koordgen.lang.semantics.state import State
from koordgen.lang.semantics.step import initial, run_init
from koordgen.verify.attack.judge import (
    ENVIRONMENT,
    INIT,
    WELL_DEFINED,
    Act,
    ReplayedTrial,
    Trial,
    TrialJudge,
    TrialNotCovered,
    UnusableStep,
)
from koordgen.verify.prove.report.model import exact_state
from tests.verify.attack.faults import attacked, broken
from tests.verify.prove.proving import checked

# What an event does that has no value, each as a statement; `(well-defined)` promises that none of them happens.
PROMISED = {
    "index of a robot": "a = x[a - 1]",
    "index of a list": "a = xs[3]",
    "negative index": "a = xs[0 - 1 - a]",
    "index of a text": "s = s[a]",
    "assigned element": "xs[2] = 1",
    "bound of a slice": "xs = xs[a - 1:]",
    "quotient of ints": "a = 7 // a",
    "remainder of ints": "a = 7 % a",
    "quotient of floats": "f = 7.0 / f",
    "quotient of ints as a float": "f = 7 / a",
    "power of an int": "a = 2 ** (a - 1)",
    "first": "a = first(xs)",
    "last": "a = last(xs)",
    "popped": "a = xs.pop()",
    "popped at a place": "a = xs.pop(1)",
    "element looked for": "a = xs.index(5)",
    "element removed": "xs.remove(5)",
    "place of insertion": "xs.insert(4, 1)",
    "element of a set removed": "z.remove(5)",
    "key": "a = m[5]",
    "key removed": "m.remove(5)",
    "root": "f = sqrt(f - 1)",
    "requires": "a = half(a - 1)",
    "within a function": "a = seventh(a)",
}
# What discards an event as well, and is not promised.
NOT_PROMISED = {
    "64 bits": "a = (a + 3000000000) ** 4",
    "capacity": "xs = [1, 2, 3, 4, 5, 6]",
    "turns of loops": "while a >= 0: a += 1",
    "exponent": "a = 2 ** (a + 5000)",
}
HEAD = """
extern fun half(int x) -> int:
  requires: x >= 0
fun seventh(int x) -> int: return 7 // x
allread: int x[N_SYS]
local:
  int a
  float f
  string s
  List<int> xs max 4
  Set<int> z max 4
  Map<int, int> m max 4
  bool done
"""
IN_EVENT = (
    HEAD + "Go:\n  pre: not done\n  eff:\n    {statement}\n    done = True\ninvariant Q: forall i in ID: a[i] == a[i]\n"
)
IN_INIT = (
    HEAD + "init:\n  {statement}\nGo:\n  pre: not done\n  eff: done = True\ninvariant Q: forall i in ID: a[i] == a[i]\n"
)


@pytest.mark.parametrize("operation", PROMISED)
def test_what_is_promised_and_fails_contradicts_well_defined(operation: str) -> None:
    for text in (IN_EVENT, IN_INIT) if "x[" not in PROMISED[operation] else (IN_EVENT,):  # init reads no slots
        assert broken(attacked(text.format(statement=PROMISED[operation]), [WELL_DEFINED])) == WELL_DEFINED


@pytest.mark.parametrize("operation", PROMISED)
def test_it_contradicts_nothing_where_well_defined_is_not_proved(operation: str) -> None:
    assert broken(attacked(IN_EVENT.format(statement=PROMISED[operation]), ["Q"])) == ""


@pytest.mark.parametrize("operation", NOT_PROMISED)
def test_what_is_not_promised_contradicts_nothing(operation: str) -> None:
    assert broken(attacked(IN_EVENT.format(statement=NOT_PROMISED[operation]), [WELL_DEFINED, "Q"])) == ""


@pytest.mark.parametrize("guard", ["x[a + 7] == 0", "7 // a == 0", "first(xs) == 0", "seventh(a) == 0"])
def test_a_guard_without_a_value_contradicts_well_defined(guard: str) -> None:
    text = HEAD + f"Go:\n  pre: not done and {guard}\n  eff: done = True\ninvariant Q: forall i in ID: a[i] == 0\n"
    assert broken(attacked(text, [WELL_DEFINED])) == WELL_DEFINED


@pytest.mark.parametrize(
    ("formula", "name"),
    [("xs[i][0] == 0", "Q"), ("7 // a[i] > 0", "Q"), ("2 ** (a[i] + 5000) > 0", ""), ("sqrt(2.0) + f[i] > 0", "")],
)
def test_an_invariant_without_a_value_is_contradicted(formula: str, name: str) -> None:
    """But not where it is the semantics that cannot tell."""
    text = HEAD + f"Go:\n  pre: not done\n  eff: done = True\ninvariant Q: forall i in ID: {formula}\n"
    assert broken(attacked(text, ["Q"])) == name


def test_where_init_is_discarded_no_mission_begins() -> None:
    """The robot rests, so that nothing is said of what follows."""
    text = HEAD + "init:\n  xs = [1, 2, 3, 4, 5]\n  done = True\nGo:\n  pre: done\n  eff: a = 1\n"
    found = attacked(text + "invariant Q: forall i in ID: done[i]\n", ["Q"])
    assert found.contradiction is None
    assert found.of(INIT, "Q")[0] == 0 and "`init` is discarded: xs would become" in found.of(INIT, "Q")[1]


COUNTER = """
using Dev:
  sensors: int level
  assume level' >= level
allread: int x[N_SYS]
local: int a
init: a = 1
Up:
  pre: a < 3
  eff: a += 1
Down:
  pre: a == 3
  eff: a = 0
initially: forall i in ID: Dev.level[i] >= 0
invariant Q: forall i in ID: a[i] >= 1
"""


def judge() -> TrialJudge:
    return TrialJudge(exact(checked(COUNTER)), ["Q"], lambda *_: ())


def begun(a: int = 1, level: int = 0) -> State:
    """One robot at a round's start."""
    program = exact(checked(COUNTER))
    state = run_init(program, exact_state(initial(program, 1)))[0]
    robot = state.robots[0]
    return state._replace(robots=(robot._replace(locals={"a": a}, ports={"Dev.level": level}),))


def launched(level: int = 0) -> State:
    program = exact(checked(COUNTER))
    return exact_state(initial(program, 1, [{"Dev.level": level}]))


def moved(level: int) -> Act:
    return Act(ENVIRONMENT, None, ({"Dev.level": level},))


def followed(state: State, *acts: Act) -> ReplayedTrial:
    return judge().replay(Trial(state, acts))


def test_a_trial_is_run_step_by_step() -> None:
    found = followed(begun(3), Act("Down", 0))
    assert found.contradiction is not None and found.contradiction.breach == ("Q", "it is false")
    assert [state.robots[0].locals["a"] for state in found.states] == [3, 0]
    quiet = followed(begun(2), Act("Up", 0), moved(1))
    assert quiet.contradiction is None
    assert [state.robots[0].ports["Dev.level"] for state in quiet.states] == [0, 0, 1]
    assert followed(launched(), Act(INIT)).contradiction is None
    rounds = followed(launched(), Act(INIT), Act("Up", 0), moved(2), Act("Up", 0), moved(2), Act("Down", 0))
    assert rounds.contradiction is not None and [state.round for state in rounds.states] == [0, 1, 1, 2, 2, 3, 3]


@pytest.mark.parametrize(
    ("state", "acts", "said"),
    [
        (begun(0), [Act("Up", 0)], "the first state of the trial violates Q"),
        (launched(-1), [Act(INIT)], "violates a formula of `initially`"),
        (launched(), [Act("Up", 0)], "must begin with `init`"),
        (begun(1), [Act(INIT)], "must begin with `init`"),
        (begun(1), [Act("Down", 0)], "robot 0 may not run event Down at this step"),
        (begun(1), [Act("Up", 0), Act("Up", 0)], "two events in one round"),
        (begun(3), [Act("Down", 0), moved(1)], "has further steps after a step"),
    ],
)
def test_a_trial_that_no_verdict_speaks_of_is_refused(state: State, acts: list[Act], said: str) -> None:
    with pytest.raises(TrialNotCovered, match=said.replace("(", r"\(")):
        followed(state, *acts)


def test_a_move_that_the_assumptions_do_not_allow_shows_nothing() -> None:
    with pytest.raises(UnusableStep, match="do not allow"):
        followed(begun(1, level=5), moved(4))


def test_a_stopped_robot_runs_nothing() -> None:
    state = begun(1)
    stopped: Any = state.robots[0]._replace(stopped=True)
    with pytest.raises(TrialNotCovered, match="may not run"):
        followed(state._replace(robots=(stopped,)), Act("Up", 0))
