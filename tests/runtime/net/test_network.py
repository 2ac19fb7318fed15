"""The network in memory: conditions of each link, the same seed the same arrivals, groups."""

from __future__ import annotations

from koordgen.runtime.net.network import Conditions, MemoryNetwork
from koordgen.runtime.values.clock import SimulatedClock


def arrivals(seed: int) -> list[tuple[float, int, bytes]]:
    """(time, receiver, datagram) of 100 datagrams from robot 0 to 1, over a bad link, and to 2, over a good one."""
    clock = SimulatedClock()
    network = MemoryNetwork(clock, seed, Conditions(delay=0.001))
    network.links[0, 1] = Conditions(loss=0.5, delay=0.01, jitter=0.02, duplication=0.1)
    transports = [network.transport(pid) for pid in range(3)]
    found = []
    for step in range(140):
        clock.time = step / 1000
        if step < 100:
            transports[0].send([1, 2], b"%d" % step)
        found += [(clock.time, pid, d) for pid in (1, 2) for d in transports[pid].receive()]
    return found


def test_each_link_has_its_conditions() -> None:
    found = arrivals(1)
    good = [(time, int(d)) for time, pid, d in found if pid == 2]
    assert [n for _, n in good] == list(range(100))
    assert all(abs(time - n / 1000) < 0.0021 for time, n in good)
    bad = [(time, int(d)) for time, pid, d in found if pid == 1]
    assert 30 < len(bad) < 80
    assert all(0.0099 < time - n / 1000 < 0.0311 for time, n in bad)
    numbers = [n for _, n in bad]
    assert numbers != sorted(numbers), "jitter overtakes"
    assert len(set(numbers)) < len(numbers), "some come twice"


def test_the_same_seed_is_the_same_network() -> None:
    assert arrivals(7) == arrivals(7) != arrivals(8)


def test_over_a_group_the_others_hear_it_too() -> None:
    network = MemoryNetwork(SimulatedClock(), 1, Conditions(delay=0.0), group=True)
    transports = [network.transport(pid) for pid in range(4)]
    transports[1].send([0, 2], b"group")
    transports[1].send([2], b"alone")
    assert [t.receive() for t in transports] == [[b"group"], [], [b"group", b"alone"], [b"group"]]


def test_a_robot_that_starts_anew_hears_nothing_of_before() -> None:
    network = MemoryNetwork(SimulatedClock(), 1, Conditions(delay=0.0))
    transports = [network.transport(pid) for pid in range(2)]
    transports[0].send([1], b"old")
    anew = network.transport(1)
    transports[1].close()  # its predecessor, which takes nothing away from it
    transports[0].send([1], b"new")
    assert anew.receive() == [b"new"] and transports[1].receive() == []


def test_when_so_many_have_arrived() -> None:
    network = MemoryNetwork(SimulatedClock(), 1)
    transports = [network.transport(pid) for pid in range(3)]
    for pid, delay in ((0, 0.03), (2, 0.01), (0, 0.02)):
        network.links[pid, 1] = Conditions(delay=delay)
        transports[pid].send([1], b"x")
    assert [network.next_arrival(1, count) for count in (1, 2, 3, 4)] == [0.01, 0.02, 0.03, float("inf")]
    assert network.next_arrival(0) == network.next_arrival(9) == float("inf")
