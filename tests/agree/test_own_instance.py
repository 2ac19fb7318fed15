"""Own-instance evaluation: a robot's verdict on a property is the same with and without asking for other robots."""

from __future__ import annotations

from collections import Counter
from random import Random
from typing import Any

import pytest

from koordgen.build.emit.program import program_text
from koordgen.build.emit.property import properties_text
from koordgen.lang.ir.verify import verify
from koordgen.runtime.program.property import UNKNOWN, Known, judged
from tests.agree.both import Generated
from tests.agree.formulas import with_formulas
from tests.agree.programs import N_SYS, random_state
from tests.agree.test_properties import properties, values
from tests.build.emit.generated import checked, in_one_line


@pytest.mark.parametrize(
    ("formula", "alone"),
    [
        ("forall i in ID: Motion.position[i].x > 0", True),
        ("forall i in ID: x[i] > 0", False),
        ("forall i in ID: on[i] or x[i] > 0", True),
        ("forall i in ID: x[i] > 0 or on[i]", False),  # an x tells that it holds
        ("forall i in ID: x[i] > 0 and on[i]", False),  # ... that it does not
        ("forall i in ID: (x[i] if on[i] else 0) == 0", True),
        ("forall i, j in ID: i == j or Motion.position[i].x > x[j]", True),
        ("forall i, j in ID: i != j or on[i]", False),  # of i alone: it would do, but nobody needs it
        ("forall i in ID: x[i] > 0 or not on[0]", False),
        ("exists i in ID: on[i]", False),
        ("forall i in ID: forall k in few: k > 0 or on[i]", False),
        ("forall i in range(1, N_SYS): on[i]", False),
        ("not (forall i in ID: not on[i])", True),
    ],
)
def test_which_formulas_each_robot_tells_for_itself_alone(formula: str, alone: bool) -> None:
    program = checked(
        "param List<int> few = [1, 2]\nusing Motion:\n  sensors: Point position\nallread: int x[N_SYS]\n"
        f"local: bool on\nE:\n  pre: True\n  eff: pass\ninvariant Asked: {formula}\n"
    )
    assert ("s.own('i'" in in_one_line(properties_text(program))) == alone


def compare(seed: int, seen: Counter[str]) -> None:
    """Evaluate one robot's knowledge in two ways: over all robots, and over its own instance."""
    program = with_formulas(seed)
    verify(program)
    generated = Generated(program, program_text(program))
    emitted = properties(program, generated)
    shared = {v.name for v in program.shared}
    state = random_state(Random(seed), program)
    held = values(program, generated, state)
    for pid in range(N_SYS):
        mine = {
            name: value if name in shared else [v if p == pid else UNKNOWN for p, v in enumerate(value)]
            for name, value in held.items()
        }
        known: list[Known] = []
        for own in (-1, pid):
            each: Any = emitted.fleet(N_SYS, None)
            each.put(mine)
            each.pid = own
            known.append(each)
        for asked in emitted.properties:
            wanted, found = (judged(asked.holds, each)[0] for each in known)
            assert found == wanted or wanted == "no value", f"with_formulas({seed}), pid {pid}: {asked.name}"
            seen[found] += 1


def test_nothing_is_lost_by_not_asking_for_the_others() -> None:
    seen: Counter[str] = Counter()
    for seed in range(30):
        compare(seed, seen)
    assert min(seen[outcome] for outcome in ("held", "violated", "unknown")) >= 20, seen


@pytest.mark.slow
def test_nothing_is_lost_in_1000_programs() -> None:
    for seed in range(1000, 2000):
        compare(seed, Counter())
