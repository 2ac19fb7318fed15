"""State-space reduction: variables that may be removed because nobody reads them, and those that may not."""

from __future__ import annotations

import pytest

from koordgen.verify.explore.search import DEADLOCK, WELL_DEFINED
from tests.lang.semantics.programs import compiled
from tests.verify.explore.reference import LEVEL, explored

TURNS = """
allread: int n[N_SYS]
local: int wait
  int last
  bool told

Look:
  pre: n[pid] < 2 and not told
  eff:
    n[pid] = n[pid] + 1
    wait = 3
    last = n[pid]
Wait:
  pre: wait > 0
  eff: wait = wait - 1
End:
  pre: n[pid] == 2
  eff: stop
invariant Small: forall i in ID: n[i] <= 2
"""


def test_a_counter_that_only_runs_down_is_forgotten_and_its_event_still_seen() -> None:
    made, result = explored(compiled(TURNS), 3)
    assert result.violation is None and not result.stopped and not result.unseen
    assert made.forgetting is not None and made.forgetting.locals == ("wait", "last")  # told is in a guard
    assert result.progress.states == 10  # the ways to share 0, 1 or 2 among three robots that are alike
    assert explored(compiled(TURNS), 3, forgetting=False)[1].progress.states > 300


def test_what_is_read_late_is_kept() -> None:
    late = TURNS.replace("pre: n[pid] == 2\n  eff: stop", "pre: n[pid] == 2\n  eff:\n    n[pid] = n[pid] + last // 2")
    made, result = explored(compiled(late), 2)
    assert made.forgetting is not None and made.forgetting.locals == ("wait",)
    assert result.violation is not None and result.violation.name == "Small"
    plain = explored(compiled(late), 2, forgetting=False)[1].violation
    assert plain is not None and [m.event for m in result.violation.run_states] == [m.event for m in plain.run_states]


def test_a_fault_in_an_event_that_is_left_out_is_found_by_a_run_of_fewest_rounds() -> None:
    for fault in (
        TURNS.replace("wait = wait - 1", "wait = wait - 1 + 0 // (wait - 2)"),
        TURNS.replace("wait > 0", "6 // wait > 0"),
    ):
        for forgetting in (True, False):
            found = explored(compiled(fault), 2, forgetting=forgetting)[1].violation
            assert found is not None and found.name == WELL_DEFINED and "Wait of robot 0" in found.reason
        plain = explored(compiled(fault), 2, forgetting=False)[1].violation
        made = explored(compiled(fault), 2)[1].violation
        assert plain is not None and made is not None and len(plain.run_states) == len(made.run_states)


def test_deadlocks_are_those_of_the_plain_search() -> None:
    stays = TURNS.replace("n[pid] == 2\n  eff: stop", "n[pid] == 2 and n[0] == 1\n  eff: stop")
    results = [explored(compiled(stays), 2, forgetting=forgetting)[1].violation for forgetting in (True, False)]
    assert all(found is not None and found.name == DEADLOCK for found in results)
    assert len({found.run_states[-1].round for found in results if found}) == 1
    turning = stays.replace("wait = wait - 1", "wait = 1 if wait == 2 else 2")  # for ever: no deadlock
    for forgetting in (True, False):
        assert explored(compiled(turning), 2, forgetting=forgetting)[1].violation is None


ENDS = """
allread: bool a[N_SYS]
local: bool done
Done:
  pre: done
  eff: stop
Say:
  pre: {}
  eff:
    a[pid] = True
    done = True
"""


@pytest.mark.parametrize("guard", ["not done", "not done or a[0]", "not done or not a[pid]"])
def test_a_robot_that_may_still_do_something_has_not_finished(guard: str) -> None:
    program = compiled(ENDS.format(guard))
    made, result = explored(program, 2, symmetry=False)
    assert result.violation is None and not result.stopped
    plain, _ = explored(program, 2, symmetry=False, forgetting=False)
    every = [made.machine.packed(plain.machine.state(fleet)) for fleet in plain.known]
    assert {made.alike(fleet) for fleet in every} == set(made.known)
    assert (len(made.known) < len(plain.known)) == (guard != "not done or a[0]")


def test_sensors_may_wake_who_seems_to_have_finished() -> None:
    text = """
using Dev:
  sensors: int level
allwrite: int n
local: bool done
Up:
  pre: not done or Dev.level > 0
  eff:
    n = 1
    done = True
Done:
  pre: done
  eff: stop
invariant Never: n == 0
"""
    found = explored(compiled(text), 2, LEVEL)[1].violation
    assert found is not None and found.name == "Never"
