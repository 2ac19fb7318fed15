"""Link: which datagrams are admitted, that all others change nothing, and what is learned and counted."""

from __future__ import annotations

from random import Random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from benchmarks.fixtures.fleet import KEY
from koordgen.runtime.net.codec import decode
from koordgen.runtime.net.metrics import RECENT
from koordgen.runtime.net.seal import CONTROL, MEMORY, POSITION, seal
from koordgen.runtime.net.sessions import REPLAY_WINDOW, PeerSession
from koordgen.runtime.net.wire import LIMIT, Echo, Head, Message, Nack, RejoinRequest
from tests.runtime.net.links import ADOPTED, BOOTS, EPOCH, OWN, Ear, N, head, hello, sealed, word

TOP = 2**53
TOKENS = (b"", bytes(8), b"\1" * 8)


def need(made: Head) -> Message:
    return Nack(made, 3, 29, 29, (29,) * N, ())


def delays(ear: Ear, pid: int = 2) -> int:
    ear.metrics.snapshot(2.5, {})  # counts what has arrived
    return ear.metrics._peers[pid].delays.count()


# Admission.


def test_messages_of_the_mission_are_admitted_in_their_order() -> None:
    ear = Ear()
    messages = [word(head(2)), need(head(0)), word(head(3)), RejoinRequest(head(2, 72), 0, -1, 0, b"", b"")]
    assert ear.hear(*map(sealed, messages)) == messages
    assert ear.link.rejected == {}


@given(st.data())
@hypothesis_settings(max_examples=600, deadline=None)
def test_every_message_is_judged_by_all_of_its_head(data: st.DataObject) -> None:
    """The short comparison that nearly all messages pass admits none that the full judgement refuses."""
    ear = Ear()
    ear.link.epoch = data.draw(st.sampled_from((EPOCH, b"")))
    fields = {"application": st.integers(299, 300), "pid": st.integers(0, N)}
    fields |= {name: st.sampled_from(TOKENS) for name in ("interface", "program", "boot")}
    fields["epoch"] = st.sampled_from((EPOCH, b"", bytes(8)))
    changes: dict[str, Any] = data.draw(st.fixed_dictionaries({}, optional=fields))
    valid = {"interface", "program", "boot"}
    made = head(**{k: v for k, v in changes.items() if k not in valid or v})
    message = data.draw(st.sampled_from([word(made), need(made), hello(made), hello(made, 3)]))
    session = ear.link.sessions.get(made.pid)
    reason = ear.link._refusal(message, session is not None and session.boot == made.boot)
    assert ear.hear(sealed(message)) == ([] if reason else [message])
    assert ear.link.rejected == ({reason: 1} if reason else {})


def test_a_hello_of_a_boot_that_was_not_adopted_is_told_and_changes_nothing() -> None:
    ear = Ear()
    before = ear.state()
    message = hello(head(2, boot=b"boot two", sequence=900))
    assert ear.hear(sealed(message)) == [message] and ear.hear(sealed(message)) == [message]
    assert ear.state() == before


def test_a_hello_of_an_adopted_boot_is_replayed_by_nobody() -> None:
    ear = Ear()
    message = sealed(hello(head(2)))
    assert len(ear.hear(message, message)) == 1 and ear.link.rejected == {"replayed": 1}


def test_nothing_but_hello_is_admitted_before_the_mission_is_known() -> None:
    ear = Ear()
    ear.link.epoch = b""
    before = ear.state()
    assert ear.hear(sealed(word(head(2, epoch=b""))), sealed(word(head(2)))) == []
    assert ear.link.rejected == {"another mission": 2} and ear.state() == before


def test_one_that_comes_again_has_another_boot() -> None:
    ear = Ear()
    for boot, mission in ((b"boot two", EPOCH), (b"boot two", b"mission2"), (BOOTS[2], EPOCH)):
        ear.link.epoch = mission
        ear.link.adopt(hello(head(2, 5, boot=boot)))
        words = [word(head(2, 6, boot=b, epoch=e)) for b in (b"boot two", BOOTS[2]) for e in (EPOCH, b"mission2")]
        assert ear.hear(*map(sealed, words)) == [w for w in words if (w.head.boot, w.head.epoch) == (boot, mission)]
        assert ear.link.strangers == {2}


# MAC before any state change.


@pytest.mark.parametrize("length", [1, 15, 16, 63, 64, 65, 127, 128, 129, 192, 1183, LIMIT - 16])
def test_no_bit_of_a_datagram_may_be_another(length: int) -> None:
    payload = Random(length).randbytes(length)
    right = seal(KEY, MEMORY, payload)
    flipped = [right[:at] + bytes([right[at] ^ 1 << at % 8]) + right[at + 1 :] for at in range(len(right))]
    cut = [right[:at] for at in range(len(right))]
    others = [seal(key, MEMORY, payload) for key in (None, bytes(31) + b"\1")]
    others += [seal(KEY, purpose, payload) for purpose in (POSITION, CONTROL, MEMORY[:-1] + b"z")]
    assert {decode(each, KEY) for each in (*flipped, *cut, *others)} == {"not authentic"}
    assert decode(right, KEY) != "not authentic"


@given(st.data())
@hypothesis_settings(max_examples=300, deadline=None)
def test_what_is_not_authentic_changes_nothing(data: st.DataObject) -> None:
    """Whatever it says: a message that would be admitted, with one bit flipped anywhere, the MAC included."""
    ear = Ear()
    before = ear.state()
    echoes = (Echo(OWN, 1_500_000, 1_600_000),)
    made = head(data.draw(st.sampled_from((0, 2, 3))), data.draw(st.integers(0, 2**40)), echoes=echoes)
    datagram = bytearray(sealed(data.draw(st.sampled_from((word(made), need(made), hello(made))))))
    bit = data.draw(st.integers(0, 8 * len(datagram) - 1))
    datagram[bit // 8] ^= 1 << bit % 8
    assert ear.hear(bytes(datagram)) == [] and ear.link.rejected == {"not authentic": 1}
    assert ear.state() == before and not ear.link.strangers and not ear.told


@given(st.lists(st.binary(max_size=LIMIT + 1), min_size=1, max_size=5), st.booleans())
def test_random_bytes_are_refused_sealed_or_not(given_: list[bytes], genuine: bool) -> None:
    ear = Ear()
    before = ear.state()
    assert ear.hear(*[seal(KEY, MEMORY, each) for each in given_] if genuine else given_) == []
    assert sum(ear.link.rejected.values()) == len(given_) and ear.state() == before


@given(st.data())
@hypothesis_settings(max_examples=500, deadline=None)
def test_what_is_damaged_before_it_was_sealed_harms_nothing(data: st.DataObject) -> None:
    """By a robot that has the key: a message with other, more or fewer bytes."""
    ear = Ear()
    payload = bytearray(sealed(word(head(echoes=(Echo(OWN, 1_500_000, 1_600_000),))))[:-16])
    at = data.draw(st.integers(0, len(payload) - 1))
    payload[at : at + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=3))
    heard = ear.hear(seal(KEY, MEMORY, bytes(payload)), sealed(word(head(0))))
    assert len(heard) + sum(ear.link.rejected.values()) == 2


# Replay window.

NUMBERS = st.lists(st.integers(0, 3000) | st.integers(10_000, 10_100) | st.integers(2**52, 2**53), max_size=300)


@given(NUMBERS, st.integers(0, 2000))
def test_a_sequence_number_is_accepted_once(sequences: list[int], adopted: int) -> None:
    session = PeerSession(b"boot", adopted)
    accepted: set[int] = set()
    for sequence in sequences:
        newest = max({adopted} | accepted)
        wanted = sequence not in accepted and sequence > adopted and sequence > newest - REPLAY_WINDOW
        assert session.accept(sequence) == wanted
        if wanted:
            accepted.add(sequence)
        assert session.newest == max({adopted} | accepted)
        assert len(session.skipped) <= 2 * REPLAY_WINDOW


def test_nothing_up_to_the_adoption_is_accepted() -> None:
    session = PeerSession(b"boot", 3)
    assert [n for n in range(200) if session.accept(n)] == list(range(4, 200))


@given(st.integers(0, 200), st.lists(st.integers(-REPLAY_WINDOW - 130, 200) | st.integers(-3, 3), max_size=150))
def test_replays_and_what_comes_out_of_order(first: int, steps: list[int]) -> None:
    """By up to the window and beyond, whatever the kind of message."""
    ear, sequence = Ear(), ADOPTED + first
    taken, newest = set[int](), ADOPTED
    for step in [3 * REPLAY_WINDOW // 2, *steps]:
        sequence = max(0, sequence + step)
        fresh = sequence not in taken and sequence > max(ADOPTED, newest - REPLAY_WINDOW)
        assert len(ear.hear(sealed((word if step % 3 else need)(head(sequence=sequence))))) == fresh
        if fresh:
            taken.add(sequence)
            newest = max(newest, sequence)


@pytest.mark.parametrize("newest", [2000, 2047, 2048, 2 * TOP // 3])
@pytest.mark.parametrize("jump", [1, 63, 64, 65, REPLAY_WINDOW - 1, REPLAY_WINDOW, REPLAY_WINDOW + 1, 9999, TOP // 4])
def test_the_edges_of_the_window(newest: int, jump: int) -> None:
    ear, last, taken = Ear(), newest + jump, {newest, newest + jump}
    assert len(ear.hear(*[sealed(word(head(sequence=n))) for n in (newest, last)])) == 2
    edges = (0, 1, 63, 64, REPLAY_WINDOW - 1, REPLAY_WINDOW, REPLAY_WINDOW + 1, jump - 1, jump, jump + 1)
    for back in [each for each in edges if last >= each]:
        for _ in range(2):
            fresh = back < REPLAY_WINDOW and last - back not in taken
            assert len(ear.hear(sealed(word(head(sequence=last - back))))) == fresh
            taken.add(last - back)


def test_a_replay_changes_nothing() -> None:
    """Also within the datagrams of one call, and when it would teach the clock."""
    ear = Ear()
    datagram = sealed(word(head(echoes=(Echo(OWN, 1_500_000, 1_600_000),))))
    assert len(ear.hear(datagram, datagram)) == 1
    ear.clock.time += 100.0
    before = ear.state()
    assert ear.hear(datagram, datagram) == [] and ear.state() == before
    assert ear.link.rejected == {"replayed": 3}


# Stamps that the clock learns from, and that are echoed.


def test_of_two_that_were_sent_at_once_the_first_tells_when_they_arrived() -> None:
    ear = Ear()
    for i in (1, 2):
        ear.hear(sealed(word(head(sequence=ADOPTED + i, sent=1_500_000))))
        ear.clock.time += 0.001
    session = ear.link.sessions[2]
    assert (session.sent, session.arrived) == (1_500_000, 2_500_000)


def test_what_comes_late_is_not_echoed() -> None:
    ear = Ear()
    ear.hear(sealed(word(head(sequence=ADOPTED + 2, sent=1_500_000))), sealed(word(head(sent=1_400_000))))
    assert ear.link.sessions[2].sent == 1_500_000


@pytest.mark.parametrize("first", [True, False])
def test_of_two_echoes_of_ours_the_first_is_learned_from(first: bool) -> None:
    ear = Ear()
    ours = [Echo(OWN, 1_500_000 + i, 1_600_000 + i) for i in range(3)]
    echoes = (*ours, Echo(0, 1, 2)) if first else (Echo(0, 1, 2), *ours)
    ear.hear(sealed(word(head(echoes=echoes))))
    assert ear.fleet_clock.lessons == [(2, 1.5, 1.6, 2.000071, 2.5, 0.03)]


@pytest.mark.parametrize("turned", [True, False])
@pytest.mark.parametrize("differ", ["answered", "sent", "received"])
def test_of_what_comes_at_once_the_last_word_is_learned_from(differ: str, turned: bool) -> None:
    """Of each robot, whatever comes last."""
    ear = Ear()
    for kind, other in ((word, word), (word, need), (need, word)):
        ear.clock.time += 10.0
        stamps = [[3_000_000, 1_500_000, 1_600_000], [3_000_000, 1_500_000, 1_600_000]]
        stamps[1][["answered", "sent", "received"].index(differ)] += 5
        datagrams, sequence = list[bytes](), ear.link.sessions[2].newest
        for made, (answered, sent, received) in zip((kind, other), stamps, strict=True):
            sequence += 1
            datagrams.append(sealed(made(head(2, sequence, sent=answered, echoes=(Echo(OWN, sent, received),)))))
        ear.fleet_clock.lessons.clear()
        ear.hear(*datagrams[:: -1 if turned else 1], sealed(word(head(0, sequence, echoes=(Echo(OWN, 5, 6),)))))
        (late,) = [lesson for lesson in ear.fleet_clock.lessons if lesson[0] == 2]
        assert late[1:4] == tuple(stamps[1][place] / 1e6 for place in (1, 2, 0)) and len(ear.fleet_clock.lessons) == 2


def test_most_is_learned_from_who_keeps_the_time() -> None:
    """Also when it did not before: what it says next counts, however short ago it was learned from."""
    ear = Ear()
    lessons = ear.fleet_clock.lessons
    echoes = (Echo(OWN, 1_500_000, 1_600_000),)
    for pid, sequence, after, learned in [(2, 71, 0.0, 1), (2, 72, 0.3, 1), (0, 71, 0.0, 2), (0, 72, 0.3, 3)]:
        ear.clock.time += after
        ear.hear(sealed(word(head(pid, sequence, echoes=echoes))))
        assert len(lessons) == learned
    ear.link.keep_time(4, ear.clock.now())  # who was not heard yet
    ear.link.keep_time(2, ear.clock.now())
    ear.hear(sealed(word(head(2, 73, echoes=echoes))))
    assert len(lessons) == 4
    ear.link.keep_time(2, ear.clock.now())  # which is nothing new
    ear.hear(sealed(word(head(2, 74, echoes=echoes))))
    assert len(lessons) == 4


# Figures.


def test_delays_are_counted_where_both_know_fleet_time() -> None:
    ear = Ear()
    for sequence, fleet, known in ((71, 30_000, False), (72, 30_000, True), (73, None, True)):
        ear.fleet_clock._known = known
        ear.hear(sealed(word(head(sequence=sequence, fleet=fleet), sequence)))
    assert delays(ear) == 1
    found = ear.metrics.snapshot(2.5, {})["peers"]["2"]["delay_ms"]["max"]
    assert found == pytest.approx(1e3 * (2.5 - 2.000072 - 0.03), abs=1e-3)


def test_delays_of_every_length_are_counted() -> None:
    """From less than a microsecond to more than there are buckets for."""
    ear = Ear()
    ear.fleet_clock._known = True
    sequence = ADOPTED
    for power in range(-2, 53):
        sequence += 1
        sent = 2_500_000 - int(2.0**power)
        ear.hear(sealed(word(head(sequence=sequence, sent=max(0, sent), fleet=min(0, sent)), sequence)))
    assert delays(ear) == 55


def test_each_round_counts_once_and_what_is_missing_is_lost() -> None:
    ear = Ear()
    for sequence, round_ in enumerate((30, 31, 31, 35, 34, 36), ADOPTED + 1):
        ear.hear(sealed(word(head(sequence=sequence), round_)))
    assert ear.metrics.snapshot(2.5, {})["peers"]["2"]["loss"] == round(3 / 7, 3)


def test_older_rounds_come_to_count_half() -> None:
    ear = Ear()
    for i in range(RECENT + 90):
        ear.hear(sealed(word(head(sequence=100 + i), 30 + i)))
    ear.metrics.snapshot(2.5, {})  # counts what has arrived
    peer = ear.metrics._peers[2]
    assert peer.expected == peer.received == (RECENT + 1) // 2 + 89


def test_echoes_of_others_teach_nothing() -> None:
    ear = Ear()
    message = word(head(echoes=(Echo(127, 1, 2),) * 8))
    assert ear.hear(sealed(message)) == [message] and ear.fleet_clock.lessons == []


def test_an_echo_of_a_datagram_that_this_process_has_not_sent_is_not_learned_from() -> None:
    """It is of an earlier process of this robot, whose clock may have been another."""
    ear = Ear()
    ear.link._stamps = {1_500_000}
    ear.clock.time += 10.0
    for sent in (1_500_001, 1_500_000):
        sequence = ear.link.sessions[2].newest + 1
        ear.hear(sealed(word(head(2, sequence, sent=3_000_000, echoes=(Echo(OWN, sent, 1_600_000),)))))
    assert [lesson[1] for lesson in ear.fleet_clock.lessons] == [1.5]
