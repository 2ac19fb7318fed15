"""Loops in proofs: stated invariants, candidate invariants, facts about turns."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from koordgen.build.pipeline import check_file
from koordgen.verify.prove.report.verdict import InvariantVerdict, Question, prove
from koordgen.verify.prove.smt.solve import Limits, Solver


@pytest.fixture(scope="module")
def solver() -> Iterator[Solver]:
    with Solver("z3", Limits(query=2.0, total=10_000.0)) as running:
        yield running


def verdicts(tmp_path: Path, text: str, solver: Solver, robots: int | None = None) -> dict[str, InvariantVerdict]:
    path = tmp_path / "app.koord"
    path.write_text(text.lstrip())
    return {v.invariant: v for v in prove(Question(check_file(str(path)).program, robots), solver)}


SUM = """
local:
  int total
  bool done
  List<int> xs = [1, 2]
Sum:
  pre: not done
  eff:
    int k = 0
    int sum = 0
    while k < len(xs):
      invariant 0 <= k and k <= len(xs)
      invariant sum >= old(sum) + k
      sum += xs[k]
      k += 1
    total = sum
    done = True
invariant Xs: forall i in ID: forall x in xs[i]: x >= 1
invariant T: forall i in ID: total[i] >= 0
"""


def test_what_stands_at_a_loop_is_shown_and_used_behind_it(tmp_path: Path, solver: Solver) -> None:
    found = verdicts(tmp_path, SUM, solver)
    assert {name: v.verdict for name, v in found.items()} == dict.fromkeys(
        ("Xs", "T", "line 11", "line 12", "(well-defined)"), "PROVED"
    )


def test_a_false_invariant_of_a_loop_is_shown_by_a_run_of_its_event(tmp_path: Path, solver: Solver) -> None:
    found = verdicts(tmp_path, SUM.replace("old(sum) + k", "old(sum) + 2 * k"), solver)
    assert (found["line 11"].verdict, found["line 12"].verdict) == ("PROVED", "NOT INDUCTIVE")
    told = found["line 12"].explanation
    assert told is not None and told.counterexample is not None
    assert (told.counterexample.event, told.counterexample.line) == ("Sum", 12)
    assert found["T"].verdict != "PROVED"  # it rested on what is false


def test_without_the_invariant_of_the_loop_the_same_is_not_proved(tmp_path: Path, solver: Solver) -> None:
    found = verdicts(tmp_path, SUM.replace("      invariant sum >= old(sum) + k\n", ""), solver)["T"]
    assert found.verdict == "UNKNOWN"
    assert "an invariant of the loop" in found.reason


def test_an_invariant_that_a_loop_breaks_for_a_while_needs_not_hold_there(tmp_path: Path, solver: Solver) -> None:
    text = """
local:
  int a
  bool done
Go:
  pre: not done
  eff:
    a = 7
    int k = 0
    while k < N_SYS:
      a += 1
      k += 1
    a = 0
    done = True
invariant Zero: forall i in ID: a[i] == 0
"""
    assert verdicts(tmp_path, text, solver)["Zero"].verdict == "PROVED"
    assert verdicts(tmp_path, text.replace("    a = 0\n", ""), solver)["Zero"].verdict in ("FALSIFIED", "NOT INDUCTIVE")


FUNCTION = """
local:
  List<int> xs = [3, 1]
  int smallest
fun least(List<int> ys) -> int:
  int found = 0
  int k = 0
  while k < len(ys):
    invariant found <= 0
    found = min(found, ys[k])
    k += 1
  return found
Go:
  pre: True
  eff: smallest = least(xs)
invariant Small: forall i in ID: smallest[i] <= 0
"""


def test_the_invariants_of_a_function_s_loops_are_shown_once_and_used_where_it_is_called(
    tmp_path: Path, solver: Solver
) -> None:
    found = verdicts(tmp_path, FUNCTION, solver)
    assert found["Small"].verdict == found["line 8"].verdict == "PROVED"
    assert [o.obligation.event for o in found["line 8"].outcomes] == ["least", "least"]
    wrong = verdicts(tmp_path, FUNCTION.replace("found <= 0", "found < 0"), solver)
    assert wrong["line 8"].verdict == "UNKNOWN" and wrong["Small"].verdict != "PROVED"


class Case(NamedTuple):
    """Declarations and an effect; an invariant that holds by one rule about turns, and one that does not hold."""

    declared: str
    effect: str
    holds: str
    fails: str


# By the rules T1 to T6 of docs/reference/semantics.md.
TURNS = {
    "T1 places": Case(
        "int last",
        "for k in range(2, N_SYS + 4): last = k",
        "0 <= last[i] and last[i] < N_SYS + 4",
        "last[i] < N_SYS",
    ),
    "T1 places, downwards": Case(
        "int last",
        "for k in range(N_SYS + 3, 0, -2): last = k",
        "0 <= last[i]",
        "last[i] <= N_SYS",
    ),
    "T3 counted": Case(
        "int n",
        "n = 0\n    for x in xs: n += 1",
        "n[i] == 0 or n[i] == len(xs[i])",
        "n[i] == 0 or n[i] < len(xs[i])",
    ),
    "T3 counted at most": Case(
        "int n",
        "n = 0\n    for x in xs:\n      if x > 3: n += 2",
        "0 <= n[i] and n[i] <= 2 * len(xs[i])",
        "n[i] <= len(xs[i])",
    ),
    "T4 last written": Case(
        "int found = -1\n  int at = -1",
        "found = -1\n    at = -1\n    for k in range(len(xs)):\n"
        "      if xs[k] > 3:\n        found = xs[k]\n        at = k",
        "at[i] < 0 or 0 <= at[i] and at[i] < len(xs[i]) and xs[i][at[i]] == found[i] and found[i] > 3",
        "at[i] < 0 or found[i] > 5",
    ),
    "T5 bounded": Case(
        "int least = 9",
        "least = 9\n    for x in xs:\n      if x < least: least = x",
        "least[i] <= 9 and (least[i] == 9 or least[i] in xs[i])",
        "least[i] > 3",
    ),
    "T5 bounded by all": Case(
        "int low = 9\n  bool ran",
        "low = 9\n    for k in range(len(xs)): low = min(low, xs[k])\n    ran = True",
        "not ran[i] or (forall k in range(0, len(xs[i])): low[i] <= xs[i][k])",
        "not ran[i] or (forall k in range(0, len(xs[i])): low[i] < xs[i][k])",
    ),
    "T6 passed": Case(
        "int at\n  bool ran",
        "int k = 0\n    while k < len(xs) and xs[k] != 3: k += 1\n    at = k\n    ran = True",
        "not ran[i] or 0 <= at[i] and at[i] <= len(xs[i]) and (forall k in range(0, at[i]): xs[i][k] != 3)",
        "not ran[i] or at[i] < 1",
    ),
}


@pytest.mark.parametrize("rule", TURNS)
def test_facts_about_turns_prove_what_loops_leave_behind(rule: str, tmp_path: Path, solver: Solver) -> None:
    case = TURNS[rule]
    text = f"""
local:
  List<int> xs = [5, 3, 8]
  {case.declared}
Go:
  pre: True
  eff:
    {case.effect}
invariant Holds: forall i in ID: {case.holds}
invariant Fails: forall i in ID: {case.fails}
"""
    found = verdicts(tmp_path, text, solver)
    assert found["Holds"].verdict == "PROVED"
    assert found["Fails"].verdict != "PROVED"
