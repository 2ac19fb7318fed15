"""Programs on which an earlier prover was wrong: it said PROVED although a run breaks the invariant."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from koordgen.build.pipeline import check_file
from koordgen.verify.prove.report.verdict import Question, prove
from koordgen.verify.prove.smt.solve import Limits, Solver

# what was wrong -> (the program, the property that a run breaks)
BROKEN: dict[str, tuple[str, str]] = {
    "a value that a loop does not write was not checked where the loop begins": (
        """
local: int a
Go:
  pre: a == 0
  eff:
    a = 7
    int k = 0
    while k < 3: k += 1
invariant Q: forall i in ID: a[i] == 0
""",
        "Q",
    ),
    "a loop in init assumed the invariant of a variable that nothing had written yet": (
        """
local: int most
init:
  for i in ID: most = max(most, i)
Go:
  pre: True
  eff: pass
invariant Q: forall i in ID: most[i] >= 5
""",
        "Q",
    ),
    "an unset target was the origin where the program does not read the position": (
        """
using Motion:
  actuators: Point target
Go:
  pre: True
  eff: pass
invariant Q: forall i in ID: Motion.target[i] == Point(0, 0, 0)
""",
        "Q",
    ),
    "a path that does not write a shared variable undid another robot's write": (
        """
allwrite: int n
allread: bool done[N_SYS]
Fill:
  pre: n == 0 and done.count(True) == 0
  eff: atomic: n = 5
Mark:
  pre: n == 0 and not done[pid]
  eff:
    done[pid] = True
    if pid > 50: n = 0
invariant Q: forall i in ID: not (done[i] and n == 5)
""",
        "Q",
    ),
    "what a turn writes before it continues was lost where another way leaves the loop": (
        """
local:
  int a
  bool done
Go:
  pre: not done
  eff:
    for k in range(3, N_SYS + 9):
      if k == 3:
        a = 7
        continue
      break
    done = True
invariant Q: forall i in ID: a[i] == 0
""",
        "Q",
    ),
    "a guard that holds showed that its own operations have a value": (
        """
local:
  int n = 5
  bool b
Go:
  pre: [1, 2][n] == 3
  eff: b = True
Dec:
  pre: n > 0 and 7 // (n + 1) > 0
  eff: n -= 1
invariant Range: forall i in ID: 0 <= n[i] and n[i] <= 5
""",
        "(well-defined)",
    ),
    "elements before the one that is found were not looked at": (
        """
local:
  List<int> xs = [0, 7]
  bool b
fun one(List<int> ys) -> bool:
  for y in ys:
    if 7 // y == 1 and y > 3: return True
  return False
Go:
  pre: not b
  eff: b = one(xs)
invariant Two: forall i in ID: len(xs[i]) == 2 and xs[i][1] == 7
""",
        "(well-defined)",
    ),
    "a formula that has no value counted as true under a negation": (
        """
local:
  int a
  bool b
Go:
  pre: not b
  eff: b = True
invariant Q: not (exists i in ID: 1 // a[i] == 1)
""",
        "Q",
    ),
    "the loops of functions were not looked into for operations without a value": (
        """
local:
  List<int> xs = [0, 7]
  int b
fun total(List<int> ys) -> int:
  int t = 0
  for y in ys: t += 7 // y
  return t
Go:
  pre: b == 0 and 7 // (b + 1) > 0
  eff: b = total(xs)
invariant Two: forall i in ID: len(xs[i]) == 2
""",
        "(well-defined)",
    ),
    "an allread variable had one name at every place of a loop": (
        """
allread: int x[N_SYS]
local: bool done
Go:
  pre: not done
  eff:
    int k = 0
    while k < 2:
      x[pid] = 5
      k += 1
    done = True
invariant N: not 5 in x
""",
        "N",
    ),
}


@pytest.fixture(scope="module")
def solver() -> Iterator[Solver]:
    with Solver("z3", Limits(query=2.0, total=10_000.0)) as running:
        yield running


@pytest.mark.parametrize("fault", BROKEN)
def test_what_a_run_breaks_is_not_proved(fault: str, tmp_path: Path, solver: Solver) -> None:
    text, name = BROKEN[fault]
    path = tmp_path / "app.koord"
    path.write_text(text.lstrip())
    found = {v.invariant: v.verdict for v in prove(Question(check_file(str(path)).program), solver)}
    assert found[name] in ("FALSIFIED", "NOT INDUCTIVE", "UNKNOWN")


@pytest.mark.parametrize(
    "failing", ["xs[0] == 1", "first(xs) == 1", "7 // len(xs) == 1", "sqrt(float_of - 1) == 1.0", "take"]
)
def test_an_init_that_may_have_no_result_is_told_with_its_line(failing: str, tmp_path: Path, solver: Solver) -> None:
    statement = "xs.remove(3)" if failing == "take" else f"b = {failing}"
    path = tmp_path / "app.koord"
    declared = "local:\n  List<int> xs\n  float float_of\n  bool b\n"
    path.write_text(f"{declared}init:\n  {statement}\nGo:\n  pre: not b\n  eff: b = True\n")
    (found,) = prove(Question(check_file(str(path)).program), solver)
    assert (found.invariant, found.verdict) == ("(well-defined)", "NOT INDUCTIVE")
    assert found.explanation is not None and found.explanation.counterexample is not None
    assert found.explanation.counterexample.discarded.startswith("line 6: ")


def test_a_run_has_a_step_of_the_environment_between_two_rounds(tmp_path: Path, solver: Solver) -> None:
    path = tmp_path / "app.koord"
    path.write_text(
        """
using S:
  sensors: int v
  assume v' == v + 1
initially: forall i in ID: S.v[i] == 0
local: int a
Go:
  pre: True
  eff: a += 1
invariant Q: forall i in ID: a[i] <= S.v[i] + 1
""".lstrip()
    )
    (found,) = prove(Question(check_file(str(path)).program), solver)
    assert found.verdict == "NOT INDUCTIVE"  # it is true, so there is no run to a state in which it is false


def test_the_search_for_a_run_goes_on_with_more_robots_when_all_states_of_fewer_are_known(
    tmp_path: Path, solver: Solver
) -> None:
    path = tmp_path / "app.koord"
    path.write_text(
        """
allread: int x[N_SYS]
Go:
  pre: x[pid] == 0 and pid > 0 and x[pid - 1] == 0
  eff:
    atomic:
      x[pid] = 1
invariant C: forall i in ID: i == 0 or x[i] == 0 or x[i - 1] == 0
""".lstrip()
    )
    found = {v.invariant: v.verdict for v in prove(Question(check_file(str(path)).program), solver)}
    assert found["C"] == "FALSIFIED"  # by three robots in two rounds


@pytest.mark.parametrize("values, false", [("range(0, 3)", "k < 2"), ("[1, 2]", "a == 0"), ("ID", "k < 1")])
def test_a_false_invariant_of_a_short_loop_has_a_verdict(
    values: str, false: str, tmp_path: Path, solver: Solver
) -> None:
    path = tmp_path / "app.koord"
    path.write_text(
        f"""
fun f() -> int:
  int a = 0
  for k in range(0, 3):
    invariant k < 2
    a += 1
  return a
local:
  int a
  bool done
Go:
  pre: not done and f() > 0
  eff:
    for k in {values}:
      invariant {false}
      a = 5
    done = True
invariant N: forall i in ID: a[i] >= 0
""".lstrip()
    )
    question = Question(check_file(str(path)).program, 2)
    found = {v.invariant: v.verdict for v in prove(question, solver)}
    assert found["line 4"] in ("NOT INDUCTIVE", "UNKNOWN")
    assert found["line 14"] in ("NOT INDUCTIVE", "UNKNOWN")
