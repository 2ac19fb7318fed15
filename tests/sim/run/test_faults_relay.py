"""The network between agents, as a scenario wants it: its fates, and the relay that brings them about."""

from __future__ import annotations

import itertools
import socket
import time
from contextlib import suppress
from random import Random

import pytest

from koordgen.runtime.net.network import OVERTAKEN, Conditions
from targets.sim.base.medium import Medium, medium, partition
from targets.sim.base.schedule import LinkConditions, Schedule
from targets.sim.realtime.relay import LOOPBACK, MOST_WAITING, Relay, Router

NAMES = ("ann", "bob", "cem")


def arrivals(router: Router, count: int, sender: int = 0, receiver: int = 1, every: float = 0.01) -> list[bytes]:
    """Of so many datagrams, one each `every` seconds, those that arrive, in their order."""
    for k in range(count):
        router.forward(sender, receiver, b"%d" % k, k * every)
    return [datagram for _, datagram in router.due(1e9)]


def router(**conditions: float) -> Router:
    made = Router(3, seed=5)
    made.change(Medium(Conditions(**conditions)))
    return made


def test_without_faults_all_arrive_in_order() -> None:
    assert arrivals(router(), 100) == [b"%d" % k for k in range(100)]


def test_as_many_are_lost_as_asked_for() -> None:
    assert 250 < len(arrivals(router(loss=0.7), 1000)) < 350
    assert arrivals(router(loss=1.0), 100) == []


def test_as_many_come_twice_as_asked_for() -> None:
    found = arrivals(router(duplication=0.2), 1000)
    assert 1150 < len(found) < 1250 and len(set(found)) == 1000


def test_what_is_reordered_is_overtaken() -> None:
    found = [int(datagram) for datagram in arrivals(router(reordering=0.1), 1000)]
    assert sorted(found) == list(range(1000))
    late = sum(later < earlier for earlier, later in itertools.pairwise(found))
    assert 40 < late < 110


def test_delay_jitter_and_what_comes_on_top_are_bounded() -> None:
    dice = Random(1)
    delays = [d for _ in range(2000) for d in Conditions(delay=0.1, jitter=0.05).delays(dice)]
    assert 0.1 <= min(delays) < 0.101 and 0.149 < max(delays) <= 0.15
    delays = [d for _ in range(2000) for d in Conditions(delay=0.1, reordering=1.0).delays(dice)]
    assert min(delays) >= 0.1 and 0.1 + 0.9 * OVERTAKEN < max(delays) <= 0.1 + OVERTAKEN


def test_the_same_seed_has_the_same_fates() -> None:
    one, two = (arrivals(router(loss=0.3, jitter=0.1, duplication=0.1), 200) for _ in range(2))
    assert one == two


def test_a_link_has_conditions_of_its_own_where_it_says_so() -> None:
    schedule = Schedule(Conditions(loss=1.0, delay=0.2), (LinkConditions("ann", "bob", {"loss": 0.0}),))
    made = Router(3, seed=1)
    made.change(medium(schedule, NAMES))
    made.forward(0, 1, b"there", 0.0)
    made.forward(1, 0, b"back", 0.0)
    assert made.due(0.19) == [] and made.due(0.21) == [(1, b"there")]


def test_nothing_crosses_a_partition_but_what_is_under_way() -> None:
    made = Router(3, seed=1)
    whole = medium(Schedule(Conditions(delay=0.1)), NAMES)
    made.change(whole)
    made.forward(0, 2, b"before", 0.0)
    made.change(partition(whole, [["ann", "bob"], ["cem"]], NAMES))
    made.forward(0, 2, b"across", 0.0)
    made.forward(0, 1, b"within", 0.0)
    assert made.due(1.0) == [(2, b"before"), (1, b"within")]
    made.change(whole)
    made.forward(0, 2, b"healed", 1.0)
    assert made.due(2.0) == [(2, b"healed")]


def test_who_is_in_no_group_is_alone() -> None:
    parts = partition(Medium(), [["bob"]], NAMES)
    pairs = [(i, j) for i in range(3) for j in range(3) if not parts.cut(i, j)]
    assert pairs == [(0, 0), (1, 1), (2, 2)]


def test_a_flood_fills_no_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("targets.sim.realtime.relay.MOST_WAITING", 10)
    made = router(delay=1.0)
    assert len(arrivals(made, 50)) == 10 < MOST_WAITING


def test_the_relay_knows_senders_by_their_ports() -> None:
    """End to end, on the loopback."""
    robots = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(3)]
    stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    for each in robots:
        each.bind((LOOPBACK, 0))
        each.settimeout(5)
    relay = Relay([each.getsockname()[1] for each in robots], 1, partition(Medium(), [["ann", "bob"], ["cem"]], NAMES))
    try:
        stranger.sendto(b"nobody", (LOOPBACK, relay.ports[1]))
        robots[2].sendto(b"cut", (LOOPBACK, relay.ports[1]))
        robots[0].sendto(b"within", (LOOPBACK, relay.ports[1]))
        assert robots[1].recv(100) == b"within"
        relay.change(Medium())
        deadline = time.monotonic() + 5
        robots[1].settimeout(0.05)
        heard = b""
        while not heard and time.monotonic() < deadline:
            robots[2].sendto(b"healed", (LOOPBACK, relay.ports[1]))
            with suppress(TimeoutError):
                heard = robots[1].recv(100)
        assert heard == b"healed"
        relay._process.kill()
        relay._process.wait()
        with pytest.raises(OSError, match="the relay between the agents has ended"):
            relay.change(Medium())
    finally:
        relay.close()
        for each in (*robots, stranger):
            each.close()
