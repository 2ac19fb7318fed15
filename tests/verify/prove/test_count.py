"""Every obligation is generated: number and names agree with a count from the IR alone."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import pytest

from koordgen.build.pipeline import check_file
from koordgen.lang.ir.decl import Program
from koordgen.verify.prove.obligations.count import expected
from koordgen.verify.prove.obligations.generate import obligations
from tests.programs import programs_alone
from tests.verify.prove.battery.battery import BATTERY
from tests.verify.prove.proving import checked
from tests.verify.prove.randomly.programs import program as random_program

EXAMPLES = programs_alone()
LOOPS = """
param int n = 3
allread: int x[N_SYS]
local:
  int a
  List<int> xs
  bool done
fun least(List<int> ys) -> int:
  int found = 0
  for i in range(len(ys)):
    invariant 0 <= i and i <= len(ys)
    if ys[i] < found: found = ys[i]
  return found
init:
  for k in range(N_SYS): a = max(a, 0)
Go:
  pre: not done
  eff:
    for m in [1, 2, 3]:
      int k = 0
      while k < n:
        invariant k >= 0
        x[pid] = max(x[pid], 0)
        k += 1
        if k == 7: continue
    for y in xs:
      a = 1
      break
    for y in xs:
      for z in xs: a = max(a, z)
    if least(xs) < 0: done = True
    else:
      stop
Never:
  pre: False
  eff:
    if 1 == 2:
      for y in xs: a = 1
invariant A: forall i in ID: a[i] >= 0
invariant X: forall i in ID: x[i] >= 0 and a[i] >= 0
"""


def made(program: Program, robots: int | None = None) -> Counter[str]:
    """The names of the obligations of invariants, without what tells equal ones apart."""
    kinds = ("base", "event", "environment", "loop")
    names = [o.name for o in obligations(program, robots, detail="little") if o.kind in kinds]
    return Counter(re.sub(r"(-loop-\d+-(?:entry|turn))-\d+$", r"\1", name) for name in names)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_all_obligations_of_an_example_are_made(path: Path) -> None:
    program = check_file(str(path)).program
    assert made(program) == expected(program)


def test_all_obligations_of_loops_of_every_kind_are_made() -> None:
    program = checked(LOOPS)
    found = made(program)
    assert found == expected(program)
    assert found["X-Go-loop-20-entry"] == found["X-Go-loop-20-turn"] == found["line-21-Go-loop-20-turn"] == 3
    assert found["A-Go-loop-25-entry"] == 0  # no turn leads to the head again, so nothing is left behind
    assert found["A-init-loop-14-turn"] == found["line-10-least-loop-9-entry"] == 1
    assert made(program, 3) == expected(program, 3)


@pytest.mark.parametrize("name", BATTERY)
def test_all_obligations_of_the_battery_are_made(name: str) -> None:
    program = checked(BATTERY[name][0])
    assert made(program) == expected(program)


def test_all_obligations_of_random_programs_are_made() -> None:
    for seed in range(60):
        program = random_program(seed).program
        assert made(program) == expected(program), f"seed {seed}"
