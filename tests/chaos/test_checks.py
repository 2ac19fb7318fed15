"""The judges of the chaos tests find what they are there for."""

from __future__ import annotations

from dataclasses import replace

from benchmarks.fixtures.fleet import Fleet
from koordgen.runtime.net.network import Conditions
from koordgen.runtime.values.points import Point
from tests.chaos.checks import current, wrong_reads, wrong_sums
from tests.chaos.virtual import Still, counter_program, finished, steps_program, told

N, TIMES = 3, 3


def lines(fleet: Fleet, rounds: int) -> dict[int, list[dict[str, object]]]:
    for pid in range(N):
        fleet.boot(pid, Still(Point(float(pid))))
    fleet.run(5 + rounds * fleet.delta, until=lambda: finished(fleet))
    return {pid: told(robot) for pid, robot in fleet.robots.items()}


def test_a_counter_that_is_not_atomic_is_found_out() -> None:
    right = counter_program(TIMES)
    plain = replace(right, events=tuple(replace(e, lock=None) for e in right.events))
    assert wrong_sums(lines(Fleet(n=N, program=right), 30), TIMES) == []
    wrong = wrong_sums(lines(Fleet(n=N, program=plain), 30), TIMES)
    assert any("committed 3 times" in text for text in wrong)
    assert any("said: wrong: total 1, counted 3" in text for text in wrong)


def test_a_counter_that_hangs_or_a_sum_unseen_is_found_out() -> None:
    found = lines(Fleet(n=N, program=counter_program(TIMES)), 30)
    found[1] = [t for t in found[1] if t["kind"] != "stream"]
    assert wrong_sums(found, TIMES) == ["robot 1 did not see the sum: []"]
    cut = {pid: [t for t in all_told if t.get("round", 0) < 5] for pid, all_told in found.items()}  # type: ignore[operator]
    assert any(f"of {N * TIMES} totals committed" in text for text in wrong_sums(cut, TIMES))


def test_a_read_of_another_round_is_found_out() -> None:
    found = lines(Fleet(n=N, program=steps_program()), 12)
    reads, wrong = wrong_reads(found)
    assert reads >= 10 * N * (N - 1) and wrong == []
    step = next(t for t in found[0] if t["kind"] == "round" and t["round"] == 7)
    step["shared"]["read"][2] += 1  # type: ignore[index]
    assert len(wrong_reads(found)[1]) == 1


def test_rounds_without_current_state_are_counted() -> None:
    fleet = Fleet(n=N, program=steps_program(), conditions=Conditions(loss=0.6, delay=0.001))
    share, why = current(lines(fleet, 60), 10, 50)
    assert 0.0 < share < 0.99 and why["not current"]
