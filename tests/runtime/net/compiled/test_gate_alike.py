"""Links with and without the gate are fed the same datagrams: they let the same through, count and learn the same."""

from __future__ import annotations

from collections.abc import Callable
from random import Random
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from benchmarks.fixtures.fleet import KEY
from koordgen.runtime.net import wire
from koordgen.runtime.net.metrics import RECENT
from koordgen.runtime.net.seal import MEMORY, seal
from koordgen.runtime.net.sessions import REPLAY_WINDOW, WORDS
from koordgen.runtime.net.wire import (
    LIMIT,
    MAX_ECHOES,
    Accept,
    Accepted,
    Closing,
    Decided,
    Echo,
    Hello,
    Message,
    Need,
    Piece,
    Prepare,
    Promise,
    Round,
    StatePiece,
    View,
    Want,
    Write,
    encoder,
)
from tests.runtime.net.compiled.gates import (
    ADOPTED,
    BOOTS,
    EPOCH,
    OWN,
    VIEW,
    Ears,
    N,
    head,
    is_usual,
    needs_gate,
    sealed,
    word,
)
from tests.runtime.net.compiled.test_gate import VALUES, WIDE

pytestmark = needs_gate
TOP = 2**53
EDGES = (0, 1, 31, 32, 127, 128, 255, 256, 2**16 - 1, 2**16, 2**31, 2**32 - 1, 2**32, TOP - 1, TOP)
naturals = st.sampled_from(EDGES) | st.integers(0, TOP)
shifts = naturals | naturals.map(lambda n: -n) | st.sampled_from([-32, -33, -128, -129, -(2**15) - 1])
rounds = st.integers(28, 33) | naturals
shorts = st.integers(0, 40) | st.sampled_from([n for n in EDGES if n < 2**32])
tokens = st.sampled_from([b"boot of2", b"mission1", bytes(8)])
echoes = st.lists(
    st.builds(Echo, st.sampled_from([OWN, OWN, 0, 2, N, 127]), st.integers(0, 2_600_000) | naturals, naturals),
    max_size=MAX_ECHOES,
).map(tuple)
values = st.sampled_from([*map(encoder.encode, VALUES), *WIDE]).map(msgspec.Raw)
writes = st.lists(st.builds(Write, st.sampled_from([0, 1, 255, 65535]), values, st.booleans()), max_size=4).map(tuple)


@st.composite
def heads(draw: st.DrawFn) -> Any:
    """Mostly of one who is adopted, in this mission."""
    pid = draw(st.sampled_from([0, 2, 2, 2, 3]))
    fields: dict[str, Any] = {"sequence": draw(st.integers(ADOPTED, ADOPTED + 40) | naturals)}
    fields |= {"sent": draw(st.integers(0, 2_600_000) | naturals), "fleet": draw(st.none() | shifts)}
    made = head(pid, **fields, echoes=draw(echoes))
    if draw(st.integers(0, 3)):
        return made
    other = {"application": naturals, "interface": tokens, "program": tokens, "boot": tokens}
    other |= {"pid": st.sampled_from([0, OWN, 3, 4, N, 127]), "epoch": tokens | st.just(b"")}
    return msgspec.structs.replace(made, **draw(st.fixed_dictionaries({}, optional=other)))


@st.composite
def closings(draw: st.DrawFn, pid: int, round_: int) -> Closing:
    """Mostly the sender's of its round."""
    incarnation = VIEW.members[pid] if pid < N else 0
    made = Closing(
        pid, max(0, incarnation), round_, round_, draw(st.booleans()), draw(st.booleans()), draw(st.booleans()),
        draw(st.sampled_from([-1, 0, 127, 65535])), draw(writes),
    )  # fmt: skip
    if draw(st.integers(0, 2)):
        return made
    near = st.integers(max(0, round_ - 1), min(TOP, round_ + 1))
    other = {"author": st.integers(0, N), "incarnation": naturals, "first": near, "round": near}
    return msgspec.structs.replace(made, **draw(st.fixed_dictionaries({}, optional=other)))


@st.composite
def words(draw: st.DrawFn) -> Round:
    made, round_ = draw(heads()), draw(rounds)
    some = tuple(draw(closings(made.pid, round_)) for _ in range(draw(st.sampled_from([0, 1, 1, 1, 2]))))
    held = draw(st.just(()) | st.lists(shorts, max_size=9).map(tuple) | st.just((7,) * N) | st.just((2**31,) * 128))
    view = draw(st.sampled_from([VIEW.number] * 5 + [0, VIEW.number + 1, TOP]))
    emergency = draw(st.integers(0, 9)) == 0
    return Round(made, view, round_, draw(rounds), draw(rounds), emergency, held, some)


views = st.just(VIEW) | st.builds(View, naturals, naturals, st.just((0,) * N))
others: list[Callable[[Any], Message]] = [
    lambda h: Hello(h, OWN, bytes(8), b"", (), None, None),
    lambda h: Hello(h, 3, bytes(8), b"", (1,), Closing(0, 0, 0, 0), 5),
    lambda h: Need(h, VIEW.number, 30, 29, (29,) * N, ()),
    lambda h: Piece(h, 2, 200, 30, bytes(8), 0, 2, b"data" * 200),
    lambda h: Prepare(h, 1, VIEW),
    lambda h: Promise(h, 1, 2, 3, 4, True, 5, None),
    lambda h: Accept(h, 1, VIEW),
    lambda h: Accepted(h, 1, 2),
    lambda h: Decided(h, VIEW),
    lambda h: Want(h, 1, -1, 2, b"", b""),
    lambda h: StatePiece(h, 30, bytes(8), 0, 1, b"data"),
]
messages = words() | words() | words() | words() | st.builds(lambda make, h: make(h), st.sampled_from(others), heads())


def mixed(given: list[Message]) -> bool:
    """Whether what is usual and what is not comes from one robot: taken at once, the usual counts first."""
    kinds = [{m.head.pid for m in given if is_usual(m) == usual} for usual in (True, False)]
    return bool(kinds[0] & kinds[1])


@pytest.mark.parametrize("name", ["sequence", "sent", "fleet", "round", "applied", "settled", "heard", "answered"])
def test_numbers_of_every_size(name: str) -> None:
    low = {"fleet": -TOP, "sequence": ADOPTED + 1}.get(name, 0)
    for value in [*EDGES, *[-n for n in EDGES], *[-n - 1 for n in EDGES], TOP + 1]:
        ears = Ears()
        for ear in (ears.native, ears.plain):
            ear.fleet_clock._known = True
        said = {
            "round": 30,
            "applied": 29,
            "settled": 28,
            "sequence": 99,
            "sent": 1,
            "fleet": 0,
            "heard": 1,
            "answered": 2,
        }
        said[name] = value
        made = head(**{field: said[field] for field in ("sequence", "sent", "fleet")})
        made = msgspec.structs.replace(made, echoes=(Echo(OWN, said["heard"], said["answered"]),))
        ears.hear(sealed(word(made, said["round"], applied=said["applied"], settled=said["settled"])))
        ears.same()
        assert (ears.native.usual == 1) == (low <= value <= TOP) == (ears.native.link.rejected == {})


@given(st.lists(st.lists(messages, min_size=1, max_size=6), min_size=1, max_size=4), st.data())
@hypothesis_settings(max_examples=150)
def test_the_same_is_let_through_counted_and_learned(batches: list[list[Message]], data: st.DataObject) -> None:
    ears, sent, taken = Ears(), list[bytes](), 0
    for batch in batches:
        given = [d for d in map(sealed, batch) if len(d) <= LIMIT]
        sent += given
        if data.draw(st.booleans()):
            given = data.draw(st.permutations(given)) + data.draw(st.lists(st.sampled_from(sent), max_size=2))
        opened = [wire.decode(d, KEY) for d in given]
        assert not any(isinstance(m, str) for m in opened)
        at_once = [given] if not mixed([m for m in opened if not isinstance(m, str)]) else [[d] for d in given]
        for datagrams in at_once:
            heard = ears.hear(*datagrams)
            taken += sum(is_usual(m) for m in heard_as_messages(heard, datagrams))
        ears.same()
        ears.move(data.draw(st.sampled_from([0.0, 0.04, 0.06, 1.1])))
    assert ears.native.usual == taken, "all that is usual comes in that way, and nothing else"


def heard_as_messages(heard: list[Any], datagrams: list[bytes]) -> list[Message | str]:
    """Of these, those that were let through, in the same order."""
    found, left = [], list(heard)
    for datagram in datagrams:
        message = wire.decode(datagram, KEY)
        said = message if not isinstance(message, Round) else None
        if left and (left[0] == said or (isinstance(message, Round) and left[0] == as_heard(message))):
            del left[0]
            found.append(message)
    assert not left
    return found


def as_heard(message: Round) -> Any:
    return (message.head.pid, *(getattr(message, name) for name in Round.__struct_fields__[1:]))


@given(st.lists(messages, min_size=2, max_size=8))
@hypothesis_settings(max_examples=150)
def test_taken_at_once_the_same_is_let_through(given: list[Message]) -> None:
    """Whatever is among it, as long as nothing is older than the window."""
    base = [msgspec.structs.replace(m.head, sequence=ADOPTED + 1 + i) for i, m in enumerate(given)]
    ears = Ears()
    datagrams = [sealed(msgspec.structs.replace(m, head=h)) for m, h in zip(given, base, strict=True)]
    assert ears.native.hear(datagrams) == ears.plain.hear(datagrams)
    assert ears.native.link.rejected == ears.plain.link.rejected
    native, plain = ears.native.link.sessions, ears.plain.link.sessions
    assert native.columns() == plain.columns() and native.due == plain.due


@given(messages, st.data())
@hypothesis_settings(max_examples=400)
def test_what_is_damaged_before_it_was_sealed(message: Message, data: st.DataObject) -> None:
    """By a robot that has the key: another byte, or more, or fewer of them."""
    payload = wire.pack(message)[: LIMIT - 16]
    at = data.draw(st.integers(0, len(payload) - 1))
    damaged = data.draw(
        st.sampled_from([payload[:at], payload[at:], payload + payload[:at], payload[:at] + payload[at + 1 :]])
        | st.binary(min_size=1, max_size=3).map(lambda b: payload[:at] + b + payload[at + len(b) :])
    )
    ears = Ears()
    before = ears.native.columns()
    ears.hear(seal(KEY, MEMORY, damaged))
    if ears.native.link.rejected == {"malformed": 1}:
        assert ears.plain.columns() == before, "what a malformed usual one counted is all that the gate does otherwise"
    else:
        ears.same()


@pytest.mark.parametrize("seed", range(3))
def test_every_cut_and_every_byte_of_a_word(seed: int) -> None:
    chance = Random(seed)
    some = [Closing(2, 200, 30, 30, acted=True, writes=(Write(0, msgspec.Raw(encoder.encode([1.5, "ab"]))),))]
    payload = wire.pack(
        word(head(echoes=(Echo(0, 5, 6), Echo(OWN, 7, 8))), 30, some[: seed + 1], held=(7,) * N * (seed % 2))
    )
    damaged = [payload[:at] for at in range(1, len(payload))]
    for at in range(len(payload)):
        damaged += [
            payload[:at] + bytes([b]) + payload[at + 1 :] for b in {*chance.randbytes(4), 0xC0, 0x90, 0xCF, 0xDF}
        ]
    for made in damaged:
        ears = Ears()
        ears.hear(seal(KEY, MEMORY, made))
        if ears.native.link.rejected != {"malformed": 1}:
            ears.same()


@given(st.lists(st.binary(max_size=LIMIT + 1), min_size=1, max_size=5), st.sampled_from([KEY, None]), st.booleans())
def test_random_bytes(given: list[bytes], key: bytes | None, genuine: bool) -> None:
    ears = Ears(key)
    ears.hear(*[seal(key, MEMORY, each) for each in given] if genuine else given)
    ears.same()
    assert sum(ears.native.link.rejected.values()) == len(given)


@given(st.integers(0, 200), st.lists(st.integers(-REPLAY_WINDOW - 130, 200) | st.integers(-3, 3), max_size=150))
def test_replays_and_what_comes_out_of_order(first: int, steps: list[int]) -> None:
    """By up to the window and beyond, of words and of what is never usual."""
    ears, sequence = Ears(), ADOPTED + first
    taken, newest = set[int](), ADOPTED
    for step in [3 * REPLAY_WINDOW // 2, *steps]:
        sequence = max(0, sequence + step)
        fresh = sequence not in taken and sequence > max(ADOPTED, newest - REPLAY_WINDOW)
        made = word(head(sequence=sequence)) if step % 3 else Need(head(sequence=sequence), 3, 30, 29, (29,) * N, ())
        assert len(ears.hear(sealed(made))) == fresh
        if fresh:
            taken.add(sequence)
            newest = max(newest, sequence)
        ears.same()


@pytest.mark.parametrize("newest", [2000, 2047, 2048, 2 * TOP // 3])
@pytest.mark.parametrize("jump", [1, 63, 64, 65, REPLAY_WINDOW, 64 * WORDS - 1, 64 * WORDS, 64 * WORDS + 64, 9999])
def test_the_edges_of_the_window(newest: int, jump: int) -> None:
    ears, last, taken = Ears(), newest + jump, {newest, newest + jump}
    assert len(ears.hear(*[sealed(word(head(sequence=n))) for n in (newest, last)])) == 2
    for back in (
        0,
        1,
        63,
        64,
        REPLAY_WINDOW - 1,
        REPLAY_WINDOW,
        REPLAY_WINDOW + 1,
        64 * WORDS,
        jump - 1,
        jump,
        jump + 1,
    ):
        for _ in range(2):
            fresh = back < REPLAY_WINDOW and last - back not in taken
            assert len(ears.hear(sealed(word(head(sequence=last - back))))) == fresh
            taken.add(last - back)
        ears.same()


@given(st.lists(st.tuples(st.sampled_from([0, 2, 3]), rounds, st.none() | shifts, naturals), max_size=600))
@hypothesis_settings(max_examples=60)
def test_delays_and_losses_are_counted_alike(said: list[tuple[int, int, int | None, int]]) -> None:
    """Also when older ones come to count half, and when fleet time is not known here."""
    for known in (True, False):
        ears = Ears()
        for ear in (ears.native, ears.plain):
            ear.fleet_clock._known = known
        given = [
            sealed(word(head(pid, ADOPTED + 1 + i, fleet=fleet, sent=sent), round_))
            for i, (pid, round_, fleet, sent) in enumerate(said)
        ]
        for at in range(0, len(given), 7):
            ears.hear(*given[at : at + 7])
            ears.move(0.0123456)
        ears.same()


def test_of_two_that_were_sent_at_once_the_first_tells_when_they_arrived() -> None:
    ears = Ears()
    for i in (1, 2):
        ears.hear(sealed(word(head(sequence=ADOPTED + i, sent=1_500_000))))
        ears.move(0.001)
    ears.same()
    assert ears.native.link.sessions.arrived[2] == 2_500_000


def test_older_datagrams_come_to_count_half() -> None:
    ears = Ears()
    for i in range(RECENT + 90):
        ears.hear(sealed(word(head(sequence=100 + i), 30 + i + i // 100)))
        ears.same()


def test_delays_of_every_length() -> None:
    """From less than a microsecond to more than there are buckets for."""
    ears = Ears()
    for ear in (ears.native, ears.plain):
        ear.fleet_clock._known = True
    ears.move(3e-7)
    now, sequence = 2_500_000, ADOPTED
    for power in range(-2, 53):
        for factor in (0.999, 1.0, 1.001, 1.1):
            sequence += 1
            sent = now - int(factor * 2.0**power)
            ears.hear(sealed(word(head(sequence=sequence, sent=max(0, sent), fleet=min(0, sent)), sequence)))
    ears.same()
    assert ears.native.metrics._delays.count(2) == 55 * 4 == ears.native.usual


def test_one_that_comes_again_has_another_boot() -> None:
    ears = Ears()
    for boot, mission in ((b"boot two", EPOCH), (b"boot two", b"mission2"), (BOOTS[2], EPOCH)):
        for ear in (ears.native, ears.plain):
            ear.link.epoch = mission
            ear.link.adopt(Hello(head(2, 5, boot=boot), OWN, bytes(8), bytes(8), (), None, None))
        given = [
            sealed(word(head(2, 6, boot=b, epoch=e))) for b in (b"boot two", BOOTS[2]) for e in (EPOCH, b"mission2")
        ]
        assert len(ears.hear(*given)) == 1
        ears.same()
    assert ears.native.usual == 3
