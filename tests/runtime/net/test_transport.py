"""What every transport promises: the same tests over all of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial

import pytest

from koordgen.runtime.net.transport import MOST_AT_ONCE
from koordgen.runtime.net.wire import LIMIT
from tests.runtime.net import transports
from tests.runtime.net.transports import Opened

N = 3
PATIENCE = transports.PATIENCE
KINDS: dict[str, Callable[[ExitStack, int], Opened]] = {
    "memory": transports.memory,
    **{
        f"{kind}{body}": partial(transports.udp, kind=kind, native=not body)
        for kind in ("unicast", "multicast", "broadcast")
        for body in ("", " in Python")
    },
    "zenoh": transports.zenoh,
}
NEEDS = {
    "zenoh": [transports.needs_zenoh, pytest.mark.slow],  # each test waits a second; test_process uses it every day
    **{kind: [transports.needs_compiler] for kind in ("unicast", "multicast", "broadcast")},
}
ALL = [pytest.param(kind, marks=NEEDS.get(kind, [])) for kind in KINDS]


@pytest.fixture(params=ALL)
def net(request: pytest.FixtureRequest) -> Iterator[Opened]:
    with ExitStack() as stack:
        yield KINDS[request.param](stack, N)


def test_one_receiver_gets_it_and_nobody_else(net: Opened) -> None:
    net.transports[0].send([2], b"for cleo")
    assert net.collect(2, 1) == [b"for cleo"]
    assert net.is_quiet(1) and net.is_quiet(0)


def test_several_receivers_get_it_once_each_and_the_sender_does_not(net: Opened) -> None:
    net.transports[1].send([0, 2], b"for both")
    assert net.collect(0, 1) == net.collect(2, 1) == [b"for both"]
    assert all(net.is_quiet(pid) for pid in range(N))


def test_no_receivers_no_datagram(net: Opened) -> None:
    net.transports[1].send([], b"for nobody")
    assert all(net.is_quiet(pid) for pid in range(N))


def test_datagrams_keep_their_bounds_and_order(net: Opened) -> None:
    sent = [bytes([i]) * length for i, length in enumerate((1, 0, 300, LIMIT, 7))]
    for datagram in sent:
        net.transports[0].send([1, 2], datagram)
    assert net.collect(1, len(sent)) == sent
    assert net.collect(2, len(sent)) == sent


def test_all_to_all(net: Opened) -> None:
    for pid in range(N):
        net.transports[pid].send([p for p in range(N) if p != pid], b"%d" % pid)
    for pid in range(N):
        assert sorted(net.collect(pid, N - 1)) == [b"%d" % p for p in range(N) if p != pid]
    assert all(t.troubles == {} for t in net.transports)


@pytest.mark.parametrize("several", [False, True])
def test_what_strangers_send_arrives_as_it_is_and_too_much_is_cut(net: Opened, several: bool) -> None:
    for data in (b"", b"\x00", b"\xff" * LIMIT, b"long" * 1000, b"last"):
        net.inject(1, data, several)
    found: list[bytes] = []
    while b"last" not in found:
        more = net.collect(1, 1)
        assert more, found
        found += more
    assert found[:3] == [b"", b"\x00", b"\xff" * LIMIT]
    assert all(len(d) <= LIMIT + 1 for d in found) and not any(d.startswith(b"long") for d in found if len(d) <= LIMIT)


def test_a_peer_that_is_gone_is_no_trouble_for_the_others(net: Opened) -> None:
    net.transports[2].close()
    for _ in range(5):
        net.transports[0].send([2], b"anybody?")
        net.transports[0].send([1, 2], b"hello")
    assert net.collect(1, 5) == [b"hello"] * 5
    net.transports[1].send([0], b"still here")
    assert net.collect(0, 1) == [b"still here"]


def test_closed_it_does_nothing_and_raises_nothing(net: Opened) -> None:
    transport = net.transports[0]
    net.transports[1].send([0], b"too late")
    transport.close()
    transport.close()
    transport.send([1], b"x")
    transport.send([1, 2], b"x")
    transport.wait(0.001)
    assert list(transport.receive()) in ([], [b"too late"])
    assert list(transport.receive()) == []
    assert sum(v for k, v in transport.troubles.items() if k.startswith("send: ")) in (2, 3)  # of calls or datagrams
    assert net.is_quiet(1)


def test_a_flood_is_taken_in_bounded_fragments_and_blocks_no_sender(net: Opened) -> None:
    start = time.monotonic()
    for _ in range(5 * MOST_AT_ONCE):
        net.transports[0].send([1, 2], b"flood" * 60)
    assert time.monotonic() - start < PATIENCE
    net.tick()
    for _ in range(8):
        net.transports[1].wait(0.01)
        assert len(net.transports[1].receive()) <= MOST_AT_ONCE
        net.tick()
    end = time.monotonic() + PATIENCE
    heard = False
    while not heard:  # what of the flood still comes may leave it no room
        assert time.monotonic() < end
        net.transports[0].send([1], b"after it")
        heard = b"after it" in net.collect(1, 1)


def test_waiting_ends_when_something_arrives(net: Opened) -> None:
    for send in (partial(net.transports[0].send, [1]), partial(net.transports[0].send, [1, 2])):
        start = time.monotonic()
        send(b"wake up")
        net.transports[1].wait(PATIENCE)
        assert time.monotonic() - start < PATIENCE / 2
        assert net.collect(1, 1) == [b"wake up"]


def test_waiting_ends_at_its_time(net: Opened) -> None:
    for seconds in (-1.0, 0.0, 0.0004, 0.02):
        start = time.monotonic()
        net.transports[1].wait(seconds)
        assert time.monotonic() - start < seconds + PATIENCE / 2


def test_what_is_expected_is_waited_for(net: Opened) -> None:
    for datagram in (b"1", b"2", b"3"):
        net.transports[0].send([1], datagram)
        net.transports[2].send([0, 1], b"from another")
    net.tick()
    start = time.monotonic()
    net.transports[1].wait(PATIENCE, 6, PATIENCE)
    assert time.monotonic() - start < PATIENCE / 2
    found = list(net.transports[1].receive())
    assert len(found) == 6
    assert [datagram for datagram in found if datagram.isdigit()] == [b"1", b"2", b"3"]


def test_waiting_for_more_than_comes_ends(net: Opened) -> None:
    net.transports[0].send([1], b"all there is")
    net.tick()
    for seconds, gather in ((PATIENCE, 0.01), (PATIENCE, 0.0), (0.01, PATIENCE)):
        start = time.monotonic()
        net.transports[1].wait(seconds, 100, gather)
        assert time.monotonic() - start < PATIENCE / 2
    assert net.collect(1, 1) == [b"all there is"]


def test_what_was_not_taken_stays(net: Opened) -> None:
    for i in range(5):
        net.transports[0].send([1], b"%d" % i)
        net.tick()
        net.transports[1].wait(PATIENCE, i + 1, PATIENCE)
    assert net.collect(1, 5) == [b"%d" % i for i in range(5)]


def test_own_datagrams_end_no_waiting(net: Opened) -> None:
    net.transports[1].send([0, 2], b"from me")
    net.transports[1].wait(0.005, 2, 0.005)
    assert list(net.transports[1].receive()) == []
    net.transports[0].send([1], b"from another")
    assert net.collect(1, 1) == [b"from another"]
