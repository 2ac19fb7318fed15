"""The position feed: what arrives is what was measured, and when; what is hostile raises, keeps and changes nothing."""

from __future__ import annotations

import hashlib
import math
import random
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from koordgen.runtime.net.seal import POSITION, SCAN, seal
from koordgen.runtime.values.points import Point, Pose
from koordgen.runtime.vehicle.datagrams import DATAGRAMS_A_POLL, UdpLink, waiting
from koordgen.runtime.vehicle.feed import DRIFT, FARTHEST, OVERTAKEN, Feed, Sample, Transit, encode

KEY = bytes(range(32))
POSE = Pose(Point(1.0, -2.0, 0.5), 0.7)


def datagram(sequence: int = 1, key: bytes | None = KEY, **change: Any) -> bytes:
    return encode(msgspec.structs.replace(Sample("bert", 1, sequence, 5.0, POSE), **change), key)


def fed(*datagrams: bytes) -> Feed:
    feed = Feed("bert", KEY)
    for each in datagrams:
        feed.receive(each, 10.0)
    return feed


def test_what_arrives_is_what_was_measured_and_when() -> None:
    feed = Feed("bert", KEY)
    assert (feed.pose, feed.time) == (None, None)
    assert feed.receive(datagram(age=0.25), 10.0)
    assert feed.pose == POSE and feed.time == pytest.approx(9.75) and feed.dropped == ""


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (datagram(key=bytes(32)), "not authentic"),
        (datagram(key=None), "not authentic"),
        (seal(KEY, SCAN, msgspec.msgpack.encode(Sample("bert", 1, 1, 5.0, POSE))), "not authentic"),
        (datagram()[:-1], "not authentic"),
        (b"", "not authentic"),
        (seal(KEY, POSITION, b"\xc1"), "malformed"),
        (seal(KEY, POSITION, b"\x91" * 1900), "malformed"),
        (seal(KEY, POSITION, msgspec.msgpack.encode(["bert", 1, 1, 5.0, [[0, 0, 0], 0], 0.0, 0, 1])), "malformed"),
        (datagram(robot="anna"), "another robot's"),
        (datagram(pose=Pose(Point(math.nan, 0, 0))), "not finite"),
        (datagram(pose=Pose(Point(0, 0, math.inf))), "not finite"),
        (datagram(pose=Pose(Point(), math.nan)), "not finite"),
        (datagram(sent=math.nan), "not finite"),
        (datagram(age=math.inf), "not finite"),
        (datagram(pose=Pose(Point(0, FARTHEST * 1.01, 0))), "out of range"),
        (datagram(pose=Pose(Point(), 1e300)), "out of range"),
    ],
)
def test_what_is_wrong_is_counted_and_changes_nothing(bad: bytes, reason: str) -> None:
    feed = fed(datagram(3))
    before = (feed.pose, feed.time)
    assert not feed.receive(bad, 11.0)
    assert feed.rejected == {reason: 1} and (feed.pose, feed.time) == before
    assert feed.dropped == f"; dropped: 1 {reason}"


def test_what_is_repeated_or_overtaken_is_old_and_a_new_session_is_not() -> None:
    feed = fed(datagram(5), datagram(5), datagram(4), datagram(6), datagram(1, session=2), datagram(7))
    assert feed.rejected == {"old": 3}
    assert feed.receive(datagram(2, session=2), 10.0)


def test_what_was_held_up_on_its_way_is_as_old_as_it_is() -> None:
    """Samples every 20 ms; the network stalls for 0.4 s and then gives all of them at once."""
    feed = Feed("bert", KEY)
    for i in range(50):
        feed.receive(datagram(i, sent=7.0 + i * 0.02), 100.0 + i * 0.02 + 0.003)
    for i in range(50, 70):
        feed.receive(datagram(i, sent=7.0 + i * 0.02), 101.4)
        assert feed.time == pytest.approx(100.003 + i * 0.02)


def test_a_senders_clock_may_drift() -> None:
    """By 200 ppm, either way, with a jitter of 30 ms in a hundredth of the datagrams' way."""
    for rate in (1.0002, 0.9998):
        feed, jitter = Feed("bert", KEY), random.Random(1)
        worst = 0.0
        for i in range(5000):
            true = 100.0 + i * 0.02
            feed.receive(datagram(i, sent=i * 0.02 * rate), true + (0.03 if jitter.random() < 0.01 else 0.001))
            assert feed.time is not None
            worst = max(worst, abs(feed.time - true))
        assert worst < 0.002


def test_a_delay_that_grows_slowly_is_noticed() -> None:
    """By 0.05 s a second, as somebody on the way may do without the key: the samples are as old as they are."""
    feed = Feed("bert", KEY)
    for i in range(6000):
        sent = i * 0.02
        arrives = 100.0 + sent + 0.003 + 0.05 * sent
        feed.receive(datagram(i, sent=sent), arrives)
        assert feed.time is not None
        assert feed.time - (100.003 + sent) <= DRIFT * (arrives - 100.0) + 1e-6, "none is taken for a newer one"
    assert feed.time is not None and arrives - feed.time > 5.9


def test_a_senders_clock_that_runs_fast_makes_no_fresh_sample_old() -> None:
    feed = Feed("bert", KEY)
    for i in range(3000):
        feed.receive(datagram(i, sent=i * 0.02 * 1.05), 100.0 + i * 0.02)
        assert feed.time == pytest.approx(100.0 + i * 0.02)


def test_samples_of_another_application_are_refused() -> None:
    feed = Feed("bert", KEY, 7)
    assert not feed.receive(datagram(1), 10.0) and not feed.receive(datagram(2, application=8), 10.0)
    assert feed.receive(datagram(3, application=7), 10.0)
    assert feed.rejected == {"another application": 2}


def test_a_base_station_that_is_refused_for_its_session_is_told_of_once() -> None:
    feed = Feed("bert", KEY)
    assert feed.receive(datagram(1, session=9), 10.0)
    told = []
    for i in range(3 * OVERTAKEN):
        feed.receive(datagram(i, session=8), 10.0)
        told += feed.log_lines()
    assert len(told) == 1 and "earlier run of the base station" in told[0]
    for _ in range(2 * OVERTAKEN):  # one that is repeated, as networks do, is none of those
        feed.receive(datagram(2, session=9), 11.0)
    assert feed.log_lines() == []


def test_arrivals_on_a_socket_are_stamped_by_an_even_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """The agent's clock is slewed by NTP: a sample that came at once is new all the same."""
    even = 500.0
    monkeypatch.setattr("koordgen.runtime.vehicle.datagrams.raw_clock", lambda: even)
    link = UdpLink("127.0.0.1", 0)
    try:
        feed = Feed("bert", KEY)
        feed.hear(link)
    finally:
        link.close()
    for i in range(3000):
        even = 500.0 + i * 0.02
        now = 10.0 + i * 0.02 * 1.0005
        feed.receive(datagram(i, sent=i * 0.02), now)
        assert feed.time == pytest.approx(now)


def test_no_sample_is_of_the_future() -> None:
    feed = Feed("bert", KEY)
    for i, sent in enumerate((5.0, 50.0, 1e300, -1e300, 5.1)):
        feed.receive(datagram(i, sent=sent), 10.0 + i * 0.02)
        assert feed.time is not None and feed.time <= 10.0 + i * 0.02


@given(st.lists(st.tuples(st.floats(-1e12, 1e12), st.floats(0, 30)), max_size=20))
def test_transit_never_yields_a_time_to_come(arrivals: list[tuple[float, float]]) -> None:
    transit, now = Transit(), 1000.0
    for sent, later in arrivals:
        now += later
        assert transit.arrived(sent, now) <= now


_values: Any = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats()
    | st.text(max_size=8)
    | st.binary(max_size=8),
    lambda inner: st.lists(inner, max_size=7) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=12,
)


@given(st.binary(max_size=200), st.booleans())
def test_no_bytes_raise(data: bytes, sealed: bool) -> None:
    feed = fed(datagram(3))
    assert not feed.receive(seal(KEY, POSITION, data) if sealed else data, 11.0)
    assert feed.pose == POSE


@given(_values)
def test_no_authentic_value_raises(value: Any) -> None:
    feed = Feed("bert", KEY)
    feed.receive(seal(KEY, POSITION, msgspec.msgpack.encode(value)), 11.0)
    feed.receive(
        seal(KEY, POSITION, msgspec.msgpack.encode(["bert", value, value, value, [[value] * 3, value], value])), 11.0
    )
    assert feed.time is None or math.isfinite(feed.time)


def test_a_sample_fits_in_a_datagram() -> None:
    large = datagram(2**60, robot="r" * 32, session=2**60)
    assert len(large) <= 160
    assert Feed("r" * 32, KEY).receive(large, 0.0)


def test_a_poll_takes_what_a_socket_holds_and_no_more() -> None:
    class Flood:
        taken = 0

        def receive(self) -> bytes | None:
            self.taken += 1
            return b"x"

        def close(self) -> None: ...

    flood = Flood()
    assert len(list(waiting(flood))) == DATAGRAMS_A_POLL == flood.taken


def test_a_sender_needs_nothing_of_ours() -> None:
    """The bytes as docs/reference/wire.md has them."""
    payload = msgspec.msgpack.encode(["bert", 1760000000000, 1, 5.0, [[1.0, -2.0, 0.5], 0.7]])
    sealed = payload + hashlib.blake2s(payload, digest_size=16, key=KEY, person=b"k-pose").digest()
    feed = Feed("bert", KEY)
    assert feed.receive(sealed, 10.0) and feed.pose == POSE


def test_large_counts_are_told_roughly() -> None:
    feed = fed(*[b"x"] * 99)
    assert feed.dropped == "; dropped: 99 not authentic"
    feed.receive(b"x", 10.0)
    assert feed.dropped == "; dropped: 100+ not authentic"


def test_a_new_session_has_a_clock_of_its_own() -> None:
    feed = Feed("bert", KEY)
    for i in range(5):
        feed.receive(datagram(i, sent=90_000.0 + i), 10.0 + i)
    assert feed.receive(datagram(1, session=2, sent=3.0), 15.0) and feed.time == pytest.approx(15.0)
    assert feed.receive(datagram(2, session=2, sent=3.5), 15.6) and feed.time == pytest.approx(15.5, abs=1e-3)
