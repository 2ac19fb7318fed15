"""Shared memory in the benchmarks: all updates arrive, even if datagrams are lost."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import shared_memory
from benchmarks.peers_agents import settings
from benchmarks.peers_memory import SharedMemory, Update
from koordgen.runtime.agent.records import MemoryStore
from koordgen.runtime.net.network import Conditions, MemoryNetwork
from koordgen.runtime.replication.replica import TICKS, Replica
from koordgen.runtime.values.clock import SimulatedClock

N, DELTA, COUNT, STEPS = 3, 0.01, 20, 20


class Robots:
    """Fleet of the benchmark's shared memories in simulated time, with the updates that each has received."""

    def __init__(self, loss: float) -> None:
        self.clock = SimulatedClock()
        network = MemoryNetwork(self.clock, 1, Conditions(loss, delay=0.0002), group=True)
        given = [settings(pid, range(9000, 9001 + N), DELTA, "multicast") for pid in range(N)]
        self.each = [SharedMemory(g, 230, network.transport(g.pid), MemoryStore(), self.clock) for g in given]
        self.heard: list[list[tuple[int, int]]] = [[] for _ in given]

    def run(self, rounds: range) -> None:
        """Publish each of these rounds, and then receive for the length of a round."""
        for round_ in rounds:
            for robot in self.each:
                robot.publish(round_)
            self.hear()

    def hear(self) -> None:
        for _ in range(STEPS):
            self.clock.time += DELTA / STEPS
            for robot, heard in zip(self.each, self.heard, strict=True):
                heard += robot.take(0.0)


@pytest.mark.parametrize("loss", [0.0, 0.1])
def test_all_updates_of_the_benchmarks_shared_memory_arrive(loss: float) -> None:
    robots = Robots(loss)
    robots.run(range(1, COUNT + 1))
    robots.hear()  # entries that the last round lacks are requested, too
    for pid, heard in enumerate(robots.heard):
        assert sorted(heard) == [(other, r) for other in range(N) if other != pid for r in range(1, COUNT + 1)]
    missed = [robot.missed for robot in robots.each]
    assert sum(map(len, missed)) <= 20 * loss * N  # a lost entry is nearly always repeated before the next round


def test_round_0_and_all_rounds_after_it_are_found() -> None:
    robots = Robots(0.0)
    robots.run(range(COUNT + 1))
    robots.hear()
    for pid, heard in enumerate(robots.heard):
        assert sorted(heard) == [(other, r) for other in range(N) if other != pid for r in range(COUNT + 1)]
    assert not any(robot.missed for robot in robots.each)


def test_a_round_whose_entries_have_arrived_when_it_is_closed_is_found_and_applied_at_once() -> None:
    robots = Robots(0.0)
    robots.run(range(3))
    *others, last = robots.each
    for other in others:
        other.publish(3)
    robots.clock.time += 0.0005
    last.publish(3)
    assert last.take(DELTA) == [(0, 3), (1, 3)]
    state = last._replica.state
    assert state is not None and state.applied == 3


def test_in_calm_rounds_nothing_is_due_between_their_beginnings(monkeypatch: pytest.MonkeyPatch) -> None:
    between, tick = [0], Replica.tick

    def counted(self: Replica, number: int) -> None:
        between[0] += number % TICKS > 0
        tick(self, number)

    monkeypatch.setattr(Replica, "tick", counted)
    robots = Robots(0.0)
    robots.run(range(COUNT))
    assert between == [0]
    robots.each.pop()
    robots.heard.pop()
    robots.run(range(COUNT, COUNT + 3))
    assert between[0] > 10  # the entries of one robot are missing


def test_a_robot_that_lacks_entries_closes_its_rounds_without_events_and_goes_on_later() -> None:
    robots = Robots(0.0)
    robots.run(range(3))
    assert {pid for pid, r in robots.heard[0] if r == 0} == {1, 2}  # round 0 shows which robots can be heard
    lost = robots.each.pop(), robots.heard.pop()
    robots.run(range(3, 7))
    assert robots.each[0].missed == [4, 5, 6]  # without the entry of round 3 no robot writes
    robots.each.append(lost[0])
    robots.heard.append(lost[1])
    robots.run(range(7, 10))
    assert all(9 not in robot.missed for robot in robots.each)
    assert sorted(r for pid, r in robots.heard[0] if pid == 2) == list(range(10))


def test_two_robots_of_the_benchmark_that_take_turns_hear_each_round_once() -> None:
    clock = SimulatedClock()
    network = MemoryNetwork(clock, 1, Conditions(delay=0.0002))
    given = [settings(pid, range(9000, 9003), 1.0, "unicast") for pid in range(2)]
    first, second = [Update(g, 230, network.transport(g.pid), clock) for g in given]
    first.publish(0)
    clock.time += 0.001
    assert second.take(0.0) == [(0, 0)]
    second.publish(0)
    clock.time += 0.001
    assert first.take(0.0) == [(1, 0)]
    for round_ in range(1, COUNT):
        for says, hears in ((first, second), (second, first)):
            says.publish(round_)
            assert hears.take(0.0) == [] or round_ == 1, "nothing comes at once"
            clock.time += 0.001
            assert hears.take(0.0) == [(int(says is second), round_)]


@pytest.mark.parametrize(
    ("name", "taken", "worst", "holds", "tries"),
    [
        (shared_memory.KOORDGEN, 0, 0.009, True, 1),
        (shared_memory.KOORDGEN, 1, 0.009, True, 1),
        (shared_memory.KOORDGEN, 0, 0.011, False, 2),
        (shared_memory.KOORDGEN, 1, 0.011, False, 6),
        (shared_memory.KOORDGEN, 1, 0.1, False, 1),
        ("cyclonedds", 1, 0.011, False, 6),
        (shared_memory.AGENTS, 1, 0.011, False, 2),
    ],
)
def test_a_fleet_that_the_host_disturbed_is_tried_again(
    name: str, taken: int, worst: float, holds: bool, tries: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Disturbed fleets are tried again at most DISTURBED times, and fleets that are too slow anyway are not."""
    ticks, tried = [0], [0]

    def measured(n: int, delta: float, count: int) -> shared_memory.Rounds:
        tried[0] += 1
        ticks[0] += taken
        usual = 0.005 if worst < 0.1 else worst
        return shared_memory.Rounds([usual, usual, worst], 0, 0.0)

    monkeypatch.setattr(shared_memory, "taken_away", lambda: ticks[0])
    assert shared_memory.keeps(name, measured, 4, 0.01, 3) == holds
    assert tried == [tries]


@pytest.mark.parametrize(
    ("text", "ticks"), [("cpu  1 2 3 4 5 6 7 80 9 10\ncpu0 0\n", 80), ("cpu 1 2 3\n", 0), ("", 0), ("x " * 9, 0)]
)
def test_what_the_host_takes_away_is_read(text: str, ticks: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Path, "read_text", lambda path: text if path == Path("/proc/stat") else "")
    assert shared_memory.taken_away() == ticks
