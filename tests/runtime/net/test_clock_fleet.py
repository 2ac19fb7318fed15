"""The fleet's clock: the true offset lies within the bound it holds, and fleet time never runs backward."""

from __future__ import annotations

from collections.abc import Callable
from heapq import heappop, heappush
from math import inf
from random import Random

import pytest

from koordgen.runtime.net.fleet_clock import CRYSTAL, SLEW, FleetClock
from koordgen.runtime.values.clock import SimulatedClock

Delay = Callable[[Random, int, int], float]  # of a datagram from one robot to another


def wireless(random: Random, sender: int, receiver: int) -> float:
    return random.uniform(0.001, 0.02)


def lopsided(random: Random, sender: int, receiver: int) -> float:
    """Quick to the robots of higher pid, slow back."""
    return random.uniform(0.001, 0.002) if sender < receiver else random.uniform(0.015, 0.02)


class Machine:
    """A robot's local clock, as bad as crystals are, and its estimate of the fleet's."""

    def __init__(self, base: SimulatedClock, pid: int, random: Random) -> None:
        self.pid = pid
        self.local = SimulatedClock(base, random.uniform(0, 1e5), 1 + random.uniform(-CRYSTAL, CRYSTAL))
        self.fleet = FleetClock(pid)
        self.heard: dict[int, tuple[int, int]] = {}
        self.locked = False
        self.last = -inf

    def now(self) -> float:
        return round(self.local.now() * 1e6) / 1e6  # stamps are whole microseconds

    def lock(self) -> None:
        self.fleet.lock()
        self.locked = True

    def read(self) -> float:
        """Fleet time now; once locked, never less than it was before."""
        fleet = self.fleet.read(self.local.now())
        assert not self.locked or fleet >= self.last
        self.last = fleet
        return fleet


class World:
    """Robots that send each other a datagram every `period`, on a network that delays and loses."""

    def __init__(self, seed: int, n: int = 3, delay: Delay = wireless, loss: float = 0.3, period: float = 0.2) -> None:
        self.random = Random(seed)
        self.base = SimulatedClock()
        self.machines = {pid: Machine(self.base, pid, self.random) for pid in range(n)}
        self.delay, self.loss, self.period = delay, loss, period
        self.worst = 0.0  # error of any robot since it was last set
        self.refused = 0  # exchanges
        self._queue: list[tuple[float, int, int, int, tuple[int, int | None, tuple[int, int] | None] | None]] = []
        self._count = 0
        for pid in self.machines:
            self._schedule(self.random.uniform(0, period), pid, pid, None)

    def _schedule(
        self, after: float, sender: int, receiver: int, data: tuple[int, int | None, tuple[int, int] | None] | None
    ) -> None:
        self._count += 1
        heappush(self._queue, (self.base.time + after, self._count, sender, receiver, data))

    def start(self, pid: int) -> Machine:
        """A robot whose machine was booted: stamps of its last life count no more."""
        for other in self.machines.values():
            other.heard.pop(pid, None)
        machine = self.machines[pid] = Machine(self.base, pid, self.random)
        self._schedule(0, pid, pid, None)
        return machine

    def suspend(self, pid: int, seconds: float) -> Machine:
        """CLOCK_MONOTONIC stands still in a suspended machine."""
        machine = self.machines.pop(pid)
        self.run(seconds)
        machine.local._offset -= seconds * machine.local._rate
        self.machines = dict(sorted({**self.machines, pid: machine}.items()))
        self._schedule(0, pid, pid, None)
        return machine

    def run(self, seconds: float, check: bool = True) -> World:
        end = self.base.time + seconds
        while self._queue[0][0] < end:
            self.base.time, _, sender, receiver, data = heappop(self._queue)
            if receiver not in self.machines:
                continue
            if data is None:
                self._send(sender)
            else:
                self._receive(sender, self.machines[receiver], *data)
            if check:
                self.check(self.machines[receiver])
        self.base.time = end
        return self

    def _send(self, sender: int) -> None:
        machine = self.machines[sender]
        offset = machine.fleet.offset(machine.local.now())
        said = None if offset is None else round(offset * 1e6)
        for receiver in self.machines:
            if receiver != sender and self.random.random() >= self.loss:
                data = (round(machine.now() * 1e6), said, machine.heard.get(receiver))
                self._schedule(self.delay(self.random, sender, receiver), sender, receiver, data)
        self._schedule(self.period * self.random.uniform(0.7, 1.3), sender, sender, None)

    def _receive(
        self, sender: int, machine: Machine, answered: int, said: int | None, echo: tuple[int, int] | None
    ) -> None:
        now = machine.now()
        if sender not in machine.heard or answered > machine.heard[sender][0]:
            machine.heard[sender] = (answered, round(now * 1e6))
        if echo is not None:
            fleet = None if said is None else said / 1e6
            taken = machine.fleet.add(sender, echo[0] / 1e6, echo[1] / 1e6, answered / 1e6, now, fleet)
            self.refused += not taken

    def check(self, machine: Machine) -> None:
        bound = machine.fleet.bound(machine.local.now())  # before the reading it is about what others were told
        read = machine.read()
        if machine.fleet.known and machine.fleet.reference in self.machines:
            error = abs(read - self.machines[machine.fleet.reference].read())
            assert error <= machine.fleet.bound(machine.local.now()) <= bound
            self.worst = max(self.worst, error)

    def lock(self) -> World:
        for machine in self.machines.values():
            assert machine.fleet.known
            machine.read()
            machine.lock()
        return self

    def follow(self, reference: int) -> None:
        for machine in self.machines.values():
            machine.fleet.follow(reference, machine.local.now())

    def bounds(self) -> list[float]:
        return [m.fleet.bound(m.local.now()) for m in self.machines.values()]


def ten_minutes(seed: int, delay: Delay) -> World:
    """Bounds hold and readings are monotonic throughout; rates are found. `worst` is that of the second half."""
    world = World(seed, delay=delay).run(5).lock().run(295)
    world.worst = 0.0
    world.run(300)
    for machine in list(world.machines.values())[1:]:
        rate = world.machines[0].local._rate / machine.local._rate - 1
        slowest, fastest = machine.fleet._exchanges[0].rates
        assert slowest <= rate <= fastest
        assert abs(machine.fleet.drift - rate) < 20e-6
        assert machine.fleet.breaks == 0
    assert world.refused == 0
    return world


def wireless_minutes(seed: int) -> None:
    world = ten_minutes(seed, wireless)
    assert world.worst < 0.001
    assert max(world.bounds()) < 0.002


def lopsided_minutes(seed: int) -> None:
    world = ten_minutes(seed, lopsided)
    assert 0.006 < world.worst < 0.008  # half of what the ways differ by: no estimate can tell
    assert max(world.bounds()) < 0.009  # half of the least round trip, 8 ms, and what drift adds


@pytest.mark.parametrize("minutes", [wireless_minutes, lopsided_minutes])
@pytest.mark.parametrize("seed", range(2))
def test_the_error_stays_within_the_bound(seed: int, minutes: Callable[[int], None]) -> None:
    minutes(seed)


@pytest.mark.slow
@pytest.mark.parametrize("minutes", [wireless_minutes, lopsided_minutes])
@pytest.mark.parametrize("seed", range(2, 60))
def test_the_error_stays_within_the_bound_for_many_seeds(seed: int, minutes: Callable[[int], None]) -> None:
    minutes(seed)


def changes_of_reference(seed: int) -> None:
    world = World(seed, n=4).run(5).lock().run(20)
    for reference in (1, 2, 1, 3, 0):
        before = {p: m.read() for p, m in world.machines.items()}
        allowed = world.bounds()
        world.follow(reference)
        for pid, machine in world.machines.items():
            assert machine.read() == before[pid]  # nobody steps
            assert abs(before[pid] - before[reference]) <= allowed[pid] + allowed[reference]
        world.run(30)  # checks all errors from now on, now of another's time
        assert max(world.bounds()) < 0.006
        assert all(m.fleet.reference == reference and m.fleet.breaks == 0 for m in world.machines.values())


@pytest.mark.parametrize("seed", range(5))
def test_another_reference_goes_on_with_the_same_time(seed: int) -> None:
    changes_of_reference(seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5, 100))
def test_another_reference_goes_on_with_the_same_time_for_many_seeds(seed: int) -> None:
    changes_of_reference(seed)


@pytest.mark.parametrize("seed", range(5))
def test_time_goes_on_when_the_first_reference_is_gone(seed: int) -> None:
    world = World(seed).run(5).lock().run(20)
    fleet = world.machines[0].read()
    del world.machines[0]
    world.run(1, check=False)
    world.follow(1)
    world.run(60)
    for machine in world.machines.values():
        assert abs(machine.read() - fleet - 61) < 0.03


@pytest.mark.parametrize("pid", [0, 2])
def test_a_robot_that_joins_late_steps_to_the_time_of_the_others(pid: int) -> None:
    world = World(1).run(5).lock().run(20)
    del world.machines[pid]
    world.follow(1)
    world.run(10)
    late = world.start(pid)  # the machine was restarted: its local clock has another origin
    late.fleet.follow(1, late.local.now())
    known = late.fleet.known
    assert not known and late.fleet.offset(late.local.now()) is None
    assert late.fleet.bound(late.local.now()) == inf
    world.run(5)
    late.lock()
    world.run(5)
    assert late.fleet.known
    assert abs(late.read() - world.machines[1].read()) < 0.002
    world.follow(0 if pid == 0 else 1)  # and may be the reference
    world.run(10)
    assert world.bounds()[0] < 0.005


@pytest.mark.parametrize("seed", range(5))
def test_a_machine_that_was_suspended_jumps_to_the_present(seed: int) -> None:
    world = World(seed).run(5).lock().run(20)
    sleeper = world.suspend(2, 10.0)
    world.run(4, check=False)
    assert sleeper.fleet.breaks == 1
    world.run(60)
    assert abs(sleeper.read() - world.machines[0].read()) < 0.002
    assert all(m.fleet.breaks == 0 for p, m in world.machines.items() if p != 2)


def test_a_reference_that_was_suspended_is_waited_for() -> None:
    world = World(3).run(5).lock().run(20)
    world.suspend(0, 0.5)
    world.run(4, check=False)
    assert [m.fleet.breaks for m in world.machines.values()] == [0, 1, 1]
    world.run(0.5 / SLEW)  # slowed down by SLEW, and monotonic
    assert max(abs(m.read() - world.machines[0].read()) for m in world.machines.values()) < 0.003


def test_a_reference_that_was_suspended_jumps_when_it_is_one_no_more() -> None:
    world = World(3).run(5).lock().run(20)
    world.suspend(0, 10.0)
    world.follow(1)
    world.run(5, check=False)
    world.run(20)
    assert abs(world.machines[0].read() - world.machines[1].read()) < 0.003
