"""Programs on which a wrong prover said, or would say, PROVED; and a clock that counts work instead of seconds."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from koordgen.lang.ir.decl import Program
from koordgen.verify.attack.attack import AttackReport, attack
from koordgen.verify.attack.judge import WELL_DEFINED
from tests.verify.prove.proving import checked

FAULTS = {
    "a value written before a loop": """
local: int a
Go:
  pre: a == 0
  eff:
    a = 7
    int k = 0
    while k < 3: k += 1
invariant Q: forall i in ID: a[i] == 0
""",
    "a loop in init that begins before its variable is written": """
local: int most
init:
  for i in ID: most = max(most, i)
Go:
  pre: True
  eff: pass
invariant Q: forall i in ID: most[i] >= 5
""",
    "an unset target without a position": """
using Motion:
  actuators: Point target
local: int a
Go:
  pre: a == 1
  eff: a = 2
invariant Q: forall i in ID: Motion.target[i] == Point(0, 0, 0)
""",
}
TICK = 0.0002  # seconds that each look at the clock stands for: the default budget is 250 pieces of work


def ticks() -> Any:
    """A clock that goes on by TICK whenever it is looked at."""
    now = 0.0

    def clock() -> float:
        nonlocal now
        now += TICK
        return now

    return clock


def every_name(program: Program) -> list[str]:
    """A forged list of verdicts: everything is PROVED."""
    return [WELL_DEFINED, *[p.name for p in program.properties if p.kind == "invariant"]]


def attacked(text: str, proved: Collection[str] | None = None, **given: Any) -> AttackReport:
    """The attack on a program within the default budget, in work; all is PROVED unless `proved` says what is."""
    program = checked(text)
    names = every_name(program) if proved is None else proved
    return attack(program, names, **{"clock": ticks(), **given})


def broken(report: AttackReport) -> str:
    """The invariant that was contradicted; empty where none was."""
    return report.contradiction.breach.invariant if report.contradiction is not None else ""
