"""The network is hostile: what is forged, damaged, foreign, replayed or out of range raises and changes nothing."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import msgspec
import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from benchmarks.fixtures.fleet import KEY
from benchmarks.fixtures.lineform import PROGRAM
from koordgen.runtime.net import codec
from koordgen.runtime.net.seal import MEMORY, POSITION, seal, unseal
from koordgen.runtime.net.wire import (
    LIMIT,
    WIRE_FORMAT,
    Accept,
    Accepted,
    Decided,
    Entry,
    Fragment,
    Hello,
    Message,
    Nack,
    Promise,
    RejoinRequest,
    RoundMessage,
    SnapshotFragment,
    View,
    Write,
)
from koordgen.runtime.program.program import Variable
from koordgen.runtime.values.bounds import Fixed
from koordgen.runtime.values.points import Point
from tests.runtime.net.wiretap import CLEO, Wiretap, snapshot
from tests.runtime.replication.agents import snapshot_of

TOP = 2**53


@pytest.fixture(scope="module")
def tap() -> Wiretap:
    return Wiretap()


def to_alice(tap: Wiretap) -> list[bytes]:
    return [d for s, r, d in tap.heard if r == 0]


def test_a_replay_of_everything_changes_nothing(tap: Wiretap) -> None:
    dropped = tap.play(*to_alice(tap))
    assert tap.unharmed()
    assert dropped["replayed"] > 0.9 * len(to_alice(tap))


def test_what_was_meant_for_another_robot_changes_nothing_of_ours(tap: Wiretap) -> None:
    hellos = [d for s, r, d in tap.heard if r == 1 and s == CLEO and isinstance(codec.decode(d, KEY), Hello)]
    assert tap.play(*hellos) == {"for another robot": len(hellos)}
    assert tap.unharmed()


@pytest.mark.parametrize("key", [None, bytes(32)])
def test_another_key_is_not_authentic(tap: Wiretap, key: bytes | None) -> None:
    payload = unseal(KEY, MEMORY, to_alice(tap)[-1])
    assert payload is not None
    assert tap.play(seal(key, MEMORY, payload)) == {"not authentic": 1}
    assert tap.play(seal(KEY, POSITION, payload)) == {"not authentic": 1}
    assert tap.unharmed()


def test_another_format_version_is_told_apart_from_damage(tap: Wiretap) -> None:
    payload = unseal(KEY, MEMORY, to_alice(tap)[-1])
    assert payload is not None
    assert tap.play(seal(KEY, MEMORY, bytes([WIRE_FORMAT + 1]) + payload[1:])) == {"another format version": 1}


def test_oversize_is_dropped_before_anything_else(tap: Wiretap) -> None:
    assert tap.play(bytes(LIMIT + 1), bytes(65_000)) == {"oversize": 2}
    assert tap.unharmed()


@given(data=st.data())
@hypothesis_settings(max_examples=1500, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_flipped_and_cut_datagrams_are_not_authentic(tap: Wiretap, data: st.DataObject) -> None:
    datagram = bytearray(data.draw(st.sampled_from(to_alice(tap)[-40:])))
    if data.draw(st.booleans()):
        bit = data.draw(st.integers(0, len(datagram) * 8 - 1))
        datagram[bit // 8] ^= 1 << bit % 8
    else:
        del datagram[data.draw(st.integers(0, len(datagram) - 1)) :]
    assert tap.play(bytes(datagram)) == {"not authentic": 1}
    assert tap.unharmed()


@given(st.lists(st.binary(max_size=LIMIT + 10), min_size=1, max_size=5))
@hypothesis_settings(max_examples=500, deadline=None)
def test_random_bytes_change_nothing(tap: Wiretap, datagrams: list[bytes]) -> None:
    assert sum(tap.play(*datagrams).values()) == len(datagrams)
    assert tap.unharmed()


_plain = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.binary(max_size=9) | st.text("ab"),
    lambda inner: st.lists(inner, max_size=6) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=20,
)


@given(_plain | st.binary(max_size=200).map(msgspec.Raw), st.integers(0, 11))
@hypothesis_settings(max_examples=1500, deadline=None)
def test_well_sealed_nonsense_changes_nothing(tap: Wiretap, value: Any, tag: int) -> None:
    """From a robot that has the key: garbage, and a genuine head followed by garbage."""
    plain = tap.forged(lambda m: m)
    payload = unseal(KEY, MEMORY, plain)
    assert payload is not None
    head = msgspec.to_builtins(msgspec.msgpack.decode(payload[1:])[1])
    version = bytes([WIRE_FORMAT])
    for body in (value, [tag, head, value], [tag, head, 1, value, [0, 0, 0], []], [tag, head, 1, 1, [0] * 3, [value]]):
        tap.play(seal(KEY, MEMORY, version + codec.encoder.encode(body)))
    assert tap.unharmed()


NO_TEXT = b"\xa2\xff\xfe"  # MessagePack of a text of two bytes that are no UTF-8


@pytest.mark.parametrize("tag", range(12))
def test_a_text_that_is_not_unicode_is_malformed(tap: Wiretap, tag: int) -> None:
    payload = unseal(KEY, MEMORY, tap.forged(lambda m: m))
    assert payload is not None
    head = codec.encoder.encode(msgspec.msgpack.decode(payload[1:])[1])
    for body in (NO_TEXT, b"\x93" + bytes([tag]) + head + NO_TEXT, b"\x92" + bytes([tag]) + NO_TEXT):
        assert tap.play(seal(KEY, MEMORY, bytes([WIRE_FORMAT]) + body)) == {"malformed": 1}
    assert tap.unharmed()


def test_a_text_variable_of_a_peer_that_is_not_unicode_is_refused() -> None:
    text = Variable("text", "allwrite", str, Fixed(99), lambda: "")
    tap = Wiretap(replace(PROGRAM, shared=(*PROGRAM.shared, text)))
    bad = (entry(writes=(Write(2, msgspec.Raw(NO_TEXT)),)),)
    assert tap.play(tap.forged(lambda m: msgspec.structs.replace(m, entries=bad))) == {"entry does not fit": 1}
    after = snapshot(tap.victim)
    assert after[0] == tap.before[0] and after[4] == tap.before[4]


@pytest.mark.parametrize(
    "value",
    [
        View(1, 30, (0, 0)),
        View(1, 30, (0, 0, 0, 0)),
        View(1, 30, (0, -1, -1)),
        View(1, 30, (0, 2, 0)),
        View(1, 0, (0, 0, 0)),
    ],
)
def test_impossible_views_are_refused(value: View) -> None:
    words: list[Callable[[RoundMessage], Message]] = [
        lambda m: Decided(m.head, value),
        lambda m: Accept(m.head, 200, value),
        lambda m: Promise(m.head, 1, 128, 0, 20, True, 100, value),
    ]
    for change in words:
        tap = Wiretap()
        assert tap.play(tap.forged(change)) == {"view does not fit": 1}
        assert snapshot(tap.victim)[:5] == tap.before[:5] and tap.unbound()


@pytest.mark.parametrize(
    "change",
    [
        lambda m: Promise(m.head, 1, 128, 0, 20, True, 0, None),
        lambda m: Accepted(m.head, 1, 128),
        lambda m: RejoinRequest(m.head, 0, 0, 20, b"", b""),
        lambda m: RejoinRequest(m.head, 0, 7, 20, bytes(8), bytes(32)),
        lambda m: SnapshotFragment(m.head, 20, bytes(8), 0, 1, b"x"),
        lambda m: Fragment(m.head, 127, 0, 21, bytes(8), 0, 1, b"x"),
        lambda m: Fragment(m.head, 0, 0, 21, bytes(8), 0, 1, b"x"),
        lambda m: Fragment(m.head, CLEO, 0, TOP, bytes(8), 0, 1, b"x"),
    ],
)
def test_messages_that_no_robot_asked_for_bind_to_nothing(change: Callable[[RoundMessage], Message]) -> None:
    tap = Wiretap()
    tap.play(tap.forged(change))
    after = snapshot(tap.victim)
    assert after[:5] == tap.before[:5] and tap.unbound()
    tap.fleet.run(5 * tap.fleet.delta)
    assert all(r.records[-1].frame is not None for r in tap.fleet.robots.values())


def deeply_nested() -> bytes:
    return seal(KEY, MEMORY, bytes([WIRE_FORMAT]) + b"\x91" * 1100)


def test_deep_nesting_does_not_exhaust_the_stack(tap: Wiretap) -> None:
    assert tap.play(deeply_nested()) == {"malformed": 1}


def entry(author: int = CLEO, first: int = 21, round_: int = 21, writes: tuple[Write, ...] = ()) -> Entry:
    return Entry(author, 0, first, round_, writes=writes)


def write(index: int, value: Any) -> tuple[Write, ...]:
    return (Write(index, msgspec.Raw(msgspec.msgpack.encode(value))),)


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (entry(author=3), "entry does not fit"),
        (entry(author=127), "entry does not fit"),
        (entry(first=0), "entry does not fit"),
        (entry(first=22), "entry does not fit"),
        (entry(round_=10_000), "entry too far ahead"),
        (entry(first=TOP, round_=TOP), "entry too far ahead"),
        (entry(author=0, first=21, round_=22), "entry of this robot from another robot"),
        (entry(first=20, writes=write(1, 5)), "entry does not fit"),
        (entry(writes=write(2, 5)), "entry does not fit"),
        (entry(writes=write(1, 5) + write(1, 6)), "entry does not fit"),
        (entry(writes=write(1, 5) + write(0, Point())), "entry does not fit"),
        (entry(writes=write(1, "5")), "entry does not fit"),
        (entry(writes=write(1, 5.5)), "entry does not fit"),
        (entry(writes=write(1, True)), "entry does not fit"),
        (entry(writes=write(1, 2**63)), "entry does not fit"),
        (entry(writes=write(0, [1.0, 2.0, 3.0, 4.0])), "entry does not fit"),
        (entry(writes=write(0, [1.0, None, 3.0])), "entry does not fit"),
        (entry(writes=write(0, [1.0, math.nan, 3.0])), "entry does not fit"),
        (entry(writes=write(0, [1.0, 2.0, math.inf])), "entry does not fit"),
    ],
)
def test_entries_that_do_not_fit_are_refused(bad: Entry, reason: str) -> None:
    tap = Wiretap()
    dropped = tap.play(tap.forged(lambda m: msgspec.structs.replace(m, entries=(bad,))))
    assert dropped == {reason: 1}
    after = snapshot(tap.victim)
    assert after[0] == tap.before[0] and after[4] == tap.before[4]


@pytest.mark.parametrize(
    "change",
    [
        lambda m: msgspec.structs.replace(m, held=(1, 1)),
        lambda m: msgspec.structs.replace(m, held=(1,) * 4),
        lambda m: msgspec.structs.replace(m, held=(1, 2**31, 1)),
        lambda m: msgspec.structs.replace(m, settled=TOP),
        lambda m: msgspec.structs.replace(m, round=TOP),
        lambda m: msgspec.structs.replace(m, applied=TOP),
        lambda m: Nack(m.head, 0, TOP, 0, (0, 0, 0), ()),
        lambda m: Nack(m.head, 0, 0, TOP, (0, 0, 0), ()),
        lambda m: Nack(m.head, 0, 0, 0, (0, 0), ()),
    ],
)
def test_impossible_reports_are_refused(change: Callable[[RoundMessage], Message]) -> None:
    tap = Wiretap()
    sent = tap.fleet.network.sent
    assert tap.play(tap.forged(change)) == {"report does not fit": 1}
    assert snapshot(tap.victim)[:5] == tap.before[:5]
    assert tap.fleet.network.sent == sent  # nor is it answered


@pytest.mark.parametrize(
    ("field", "value", "reason"),
    [
        ("application", 1, "another application"),
        ("interface", bytes(8), "another interface"),
        ("program", bytes(8), "another program"),
        ("pid", 0, "not a peer"),
        ("pid", 3, "not a peer"),
        ("boot", bytes(8), "another boot"),
        ("epoch", bytes(8), "another mission"),
        ("epoch", b"", "another mission"),
    ],
)
def test_foreign_heads_are_dropped(tap: Wiretap, field: str, value: Any, reason: str) -> None:
    def change(m: RoundMessage) -> Message:
        return msgspec.structs.replace(m, head=msgspec.structs.replace(m.head, **{field: value}))

    assert tap.play(tap.forged(change), tap.forged(change)) == {reason: 2}
    said = [line for line in tap.victim.lines if f"robot cleo runs {reason}" in line]
    assert len(said) == (1 if reason in ("another program", "another interface") else 0)


def test_entries_of_a_flood_are_kept_only_up_to_a_bound() -> None:
    tap = Wiretap()
    link = tap.victim.agent._link
    for sequence in range(3000):

        def change(m: RoundMessage, sequence: int = sequence) -> Message:
            head = msgspec.structs.replace(m.head, sequence=m.head.sequence + sequence)
            return msgspec.structs.replace(m, head=head, entries=(entry(first=22 + sequence % 7, round_=28),))

        tap.play(tap.forged(change))
    state = snapshot_of(tap.victim)
    assert state is not None
    assert sum(len(log.later) + len(log.kept) for log in state.logs) < 100
    assert len(link.rejected) < 20
