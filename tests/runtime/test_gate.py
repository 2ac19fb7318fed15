"""The compiled gate against hashlib and against the link in plain Python: MACs, what is refused, and what it leaves to
Python; and the library that is not the one it should be."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from hashlib import blake2s
from pathlib import Path
from random import Random
from typing import Any

import msgspec
import pytest

from koordgen.runtime import courier, gate
from koordgen.runtime.gate import FALSE, OTHER, TOO_LONG, Gate
from koordgen.runtime.metrics import Metrics
from koordgen.runtime.native import NotCompiled, load
from koordgen.runtime.seal import CONTROL, MAC_SIZE, MEMORY, POSITION, seal
from koordgen.runtime.sessions import Sessions
from koordgen.runtime.transport import MOST_AT_ONCE
from koordgen.runtime.wire import (
    LIMIT,
    MAX_ECHOES,
    Closing,
    Echo,
    Head,
    Hello,
    Message,
    Need,
    Round,
    Write,
    encoder,
    pack,
)
from tests.runtime import sanitized
from tests.runtime.fleet import KEY
from tests.runtime.gates import ADOPTED, OWN, VIEW, Ear, Ears, N, head, needs_gate, plain, sealed, word
from tests.runtime.sanitized import needs_compiler
from tests.runtime.test_courier import inbox
from tests.runtime.transports import PATIENCE, needs_courier

pytestmark = needs_gate
OTHER_KEY = bytes(31) + b"\1"


def opened(key: bytes | None = KEY, found: ctypes.CDLL | None = None, purpose: bytes = MEMORY) -> Gate:
    columns = {**Sessions(N).columns(), **Metrics(OWN, N).columns()}
    found = found or gate.COMPILED.library()
    assert found is not None
    return Gate(found, N, OWN, columns, key, purpose)


def verdicts(of: Gate, datagrams: Sequence[bytes]) -> list[int]:
    told: list[int] = []
    for at in range(0, len(datagrams), MOST_AT_ONCE):
        told += of.take(datagrams[at : at + MOST_AT_ONCE], 1.0, None).verdicts
    return told


@pytest.mark.parametrize("key", [None, KEY])
def test_macs_are_hashlibs_at_every_length(key: bytes | None) -> None:
    chance = Random(1)
    payloads = [chance.randbytes(length) for length in range(1, LIMIT - MAC_SIZE + 1)]
    assert set(verdicts(opened(key), [seal(key, MEMORY, p) for p in payloads])) == {OTHER}
    for wrong in (None if key else KEY, OTHER_KEY):
        assert set(verdicts(opened(key), [seal(wrong, MEMORY, p) for p in payloads])) == {FALSE}
    for purpose in (POSITION, CONTROL, MEMORY[:-1] + b"z"):
        assert set(verdicts(opened(key), [seal(key, purpose, p) for p in payloads])) == {FALSE}
        assert set(verdicts(opened(key, purpose=purpose.ljust(8, b"\0")), [seal(key, purpose, payloads[9])])) == {OTHER}


@pytest.mark.parametrize("length", [1, 15, 16, 63, 64, 65, 127, 128, 129, 192, 1183, LIMIT - MAC_SIZE])
def test_no_bit_may_be_another(length: int) -> None:
    right = seal(KEY, MEMORY, Random(length).randbytes(length))
    of = opened()
    assert verdicts(of, [right]) == [OTHER]
    flipped = [right[:at] + bytes([right[at] ^ 1 << at % 8]) + right[at + 1 :] for at in range(len(right))]
    assert set(verdicts(of, flipped)) == {FALSE}
    assert set(verdicts(of, [right[:at] for at in range(len(right))])) == {FALSE}, "also when it is cut, to nothing"
    assert set(verdicts(of, [right + b"\0", b"\0" + right])) == {FALSE if length < LIMIT - MAC_SIZE else TOO_LONG}


# RFC 7693, Appendix B, and the first ones with a key of BLAKE2's own test vectors (blake2s-kat.txt).
VECTORS = [
    (b"", b"abc", "508c5e8c327c14e2e1a72ba34eeb452f37458b209ed63a294d999b4c86675982"),
    (bytes(range(32)), b"\0", "40d15fee7c328830166ac3f918650f807e7e01e177258cdc0a39b11f598066f1"),
    (bytes(range(32)), b"\0\1", "6bb71300644cd3991b26ccd4d274acd1adeab8b1d7914546c1198bbe9fc9d803"),
]


@pytest.fixture(scope="module")
def of_whole_digests(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    flags = [flag.replace(f"MAC_SIZE={MAC_SIZE}", "MAC_SIZE=32") for flag in gate.FLAGS]
    return load(gate.SOURCE, flags, gate.prove, tmp_path_factory.mktemp("cache"))


@pytest.mark.parametrize(("key", "text", "digest"), VECTORS)
def test_official_vectors(key: bytes, text: bytes, digest: str, of_whole_digests: ctypes.CDLL) -> None:
    """They are of whole digests and have no purpose, so it is compiled for those."""
    assert blake2s(text, key=key).hexdigest() == digest
    of = opened(key or None, of_whole_digests, bytes(8))
    right = text + bytes.fromhex(digest)
    assert verdicts(of, [right, right[:-1] + b"x", right[:-32]]) == [OTHER, FALSE, FALSE]


def test_the_longest_is_taken_and_nothing_beyond() -> None:
    longest = seal(KEY, MEMORY, bytes(LIMIT - MAC_SIZE))
    found = verdicts(opened(), [longest, seal(KEY, MEMORY, bytes(LIMIT - MAC_SIZE + 1)), bytes(65_000), b""])
    assert found == [OTHER, TOO_LONG, TOO_LONG, FALSE]
    for key in (None, KEY):
        nothing, little = seal(key, MEMORY, b""), seal(key, MEMORY, b"\0")
        assert verdicts(opened(key), [nothing, little]) == [FALSE, OTHER], "nor is it nothing"


def test_nothing_is_usual_before_the_mission_is_known() -> None:
    """Neither of whom nothing is adopted."""
    ear = Ear(True, boots=())
    usual = sealed(word(head()))
    ear.hear([usual])
    assert (ear.usual, ear.link.rejected) == (0, {"another boot": 1})
    ear.link.adopt(Hello(head(2, ADOPTED), OWN, bytes(8), bytes(8), (), None, None))
    ear.hear([usual, sealed(word(head(0)))])
    assert (ear.usual, ear.link.rejected) == (1, {"another boot": 2})
    ear.link.epoch = b""
    ear.hear([sealed(word(head(sequence=99)))])
    ear.link.epoch = b"mission2"
    ear.hear([sealed(word(head(sequence=99)))])
    assert (ear.usual, ear.link.rejected) == (1, {"another boot": 2, "another mission": 2})
    ear.hear([sealed(word(head(sequence=99, epoch=b"mission2")))])
    assert ear.usual == 2


def test_words_by_the_present_view_only_are_usual() -> None:
    ear = Ear(True)
    ear.hear([sealed(word(head(sequence=80 + i), view=i)) for i in range(5)])
    assert ear.usual == 1
    ear.link.follow(msgspec.structs.replace(VIEW, number=4))
    ear.hear([sealed(word(head(sequence=90 + i), view=i)) for i in range(6)])
    assert ear.usual == 2


def raw(index: int, value: bytes, patch: Any = False) -> bytes:
    """An encoded Write that may be none."""
    return b"\x93" + encoder.encode(index) + value + encoder.encode(patch)


def crafted(sequence: int, held: bytes = b"\x90", closing: bytes = b"\x90", round_: int = 30) -> bytes:
    """A word whose `held` and closings are these bytes."""
    made = pack(word(head(sequence=sequence), round_))
    assert made.endswith(b"\xc2\x90\x90")
    return seal(KEY, MEMORY, made[:-2] + held + closing)


def own(writes: bytes = b"\x90", flags: bytes = b"\xc2\xc3\xc2\xff", round_: int = 30) -> bytes:
    """The sender's closing of that round, of which only the places tell that it is one."""
    return b"\x91\x99\x02\xcc\xc8" + 2 * encoder.encode(round_) + flags + writes


MALFORMED = {
    "held is no array": (b"\xc0", b"\x90"),
    "held has a negative round": (b"\x91\xff", b"\x90"),
    "held has a round beyond a year": (b"\x91\xcf\0\0\0\1\0\0\0\0", b"\x90"),
    "held has more than any fleet": (b"\xdc\0\x81" + bytes(129), b"\x90"),
    "held is a map": (b"\x80", b"\x90"),
    "held is deep": (b"\x91" * 1000 + b"\x90", b"\x90"),
    "closings are a map": (b"\x90", b"\x81\x00\x00"),
    "closings are none": (b"\x90", b"\xc0"),
    "a closing without an end": (b"\x90", b"\x91\x93\x02\xcc\xc8\x1e"),
    "a closing of a round before all": (b"\x90", own().replace(b"\x1e\x1e", b"\x1e\xff")),
    "a closing of nobody": (b"\x90", own().replace(b"\x99\x02", b"\x99\xff")),
    "stopped is a number": (b"\x90", own(flags=b"\x00\xc3\xc2\xff")),
    "a lock that cannot be": (b"\x90", own(flags=b"\xc2\xc3\xc2\xfe")),
    "writes are none": (b"\x90", own(writes=b"\xc0")),
    "a write is a number": (b"\x90", own(writes=b"\x91\x05")),
    "a write without a value": (b"\x90", own(writes=b"\x91\x91\x05")),
    "an index that cannot be": (b"\x90", own(writes=b"\x91" + raw(65536, b"\x01"))),
    "a patch that is a text": (b"\x90", own(writes=b"\x91" + raw(0, b"\x01", "patch"))),
    "one field too many": (b"\x90", own(writes=b"\x91\x94\x00\x01\xc2\x00")),
    "too many writes": (b"\x90", own(writes=b"\xdc\x01\x01" + 257 * raw(0, b"\x01"))),
}


@pytest.mark.parametrize("name", MALFORMED)
def test_of_many_the_malformed_one_is_dropped(name: str) -> None:
    """From one who has the key, well formed as far as the gate looks: all others count as if it were not there."""
    good = [sealed(word(head(2, 100 + i), 40 + i, [Closing(2, 200, 40 + i, 40 + i)])) for i in range(6)]
    good[3] = sealed(word(head(0, 200, echoes=(Echo(OWN, 1_500_000, 1_600_000),)), 40))
    bad = crafted(99, *MALFORMED[name])
    ears = Ears()
    assert ears.hear(*good[:2], bad, *good[2:], good[0]) and ears.native.usual == 0
    assert ears.native.link.rejected == {"malformed": 1, "replayed": 1}
    assert len(ears.native.fleet_clock.lessons) == 1
    again = Ears()
    found = again.hear(*good)
    assert len(found) == again.native.usual == 6


@pytest.mark.parametrize(
    "value",
    [
        b"\xc1",
        b"\xdd\xff\xff\xff\xff",
        b"\xdf\xff\xff\xff\xff",
        b"\xdd\x00\x00\x04\x00\x01",
        b"\xc6\xff\xff\xff\xff",
        b"\xdb\xff\xff\xff\xff",
        b"\xc9\xff\xff\xff\xff\x01",
        b"\xc7\xff",
        b"\xd8\x01",
        b"\xdf\x80\x00\x00\x00\xdd\xff\xff\xff\xff" * 9,
        b"\xcf\x01\x02",
        b"",
    ],
)
def test_lengths_that_are_not_there(value: bytes) -> None:
    """The gate finds the end before they do."""
    for writes in (b"\x91" + raw(0, value), b"\x91\x92\x00" + value):
        ears = Ears()
        assert ears.hear(crafted(99, closing=own(writes))) == []
        assert ears.native.link.rejected == {"malformed": 1}
        ears.same()
    ears = Ears()
    assert ears.hear(crafted(99, held=value), crafted(98, held=value, closing=b"")) == []
    assert ears.native.link.rejected == {"malformed": 2}
    ears.same()


VALUES: list[Any] = [
    None, True, 0, 127, 128, 255, 256, 2**16, 2**32, 2**64 - 1, -1, -32, -33, -129, -(2**31), -(2**63), 0.5,
    "", "a" * 31, "a" * 32, "a" * 300, b"", b"b" * 300, [], [1] * 15, [1] * 16, {}, {"a": [1, {}]},
    {i: i for i in range(16)}, [[[[[]]]]], *[msgspec.msgpack.Ext(5, bytes(k)) for k in (0, 1, 2, 4, 8, 16, 17, 300)],
]  # fmt: skip
WIDE = [  # encodings of them that ours does not choose
    b"\xd9\x01a", b"\xda\x00\x01a", b"\xdb\x00\x00\x00\x01a", b"\xc5\x00\x01b", b"\xc6\x00\x00\x00\x01b",
    b"\xdc\x00\x01\x01", b"\xdd\x00\x00\x00\x01\x01", b"\xde\x00\x01\x01\x02", b"\xdf\x00\x00\x00\x01\x01\x02",
    b"\xca\0\0\0\0", b"\xcd\x00\x01", b"\xce\x00\x00\x00\x01", b"\xd0\x01", b"\xd1\x00\x01", b"\xd2\x00\x00\x00\x01",
    b"\xd3\x00\x00\x00\x00\x00\x00\x00\x01", b"\xc8\x00\x01\x05\x00", b"\xc9\x00\x00\x00\x01\x05\x00",
]  # fmt: skip


def test_the_end_of_any_value_is_found() -> None:
    """One byte too few or too many, and it is not usual."""
    ears = Ears()
    encoded = [*map(encoder.encode, VALUES), *WIDE]
    for i, value in enumerate(encoded):
        for j, (tail, usual) in enumerate([(b"", 1), (b"\x00", 0), (b"\xc0", 0)]):
            before = ears.native.usual
            writes = b"\x91\x92\x00" + value + tail
            found = ears.hear(crafted(200 + 10 * i + j, closing=own(writes)))
            assert (len(found), ears.native.usual - before) == (usual, usual), value
            if usual:
                assert bytes(found[0][-1][0].writes[0].value) == value
                cut = crafted(205 + 10 * i, closing=own(writes[:-1]))
                assert ears.hear(cut) == [] and ears.native.usual == before + 1
    ears.same()


def test_nesting_that_msgspec_can_follow_is_usual() -> None:
    ears = Ears()
    deep = b"\x91" * 60 + b"\x01"
    found = ears.hear(crafted(99, closing=own(b"\x91" + raw(0, deep))))
    assert bytes(found[0][-1][0].writes[0].value) == deep and ears.native.usual == 1
    assert ears.hear(sealed(word(head(sequence=100), 31))) and ears.native.usual == 2
    ears.same()


def test_nesting_that_msgspec_cannot_follow_harms_nothing() -> None:
    """How deep that is depends on Python; the gate follows none."""
    ears = Ears()
    deep = crafted(99, closing=own(b"\x91" + raw(0, b"\x91" * 1040 + b"\x01")))
    assert len(deep) <= LIMIT
    assert ears.hear(deep, sealed(word(head(sequence=100), 31)))[-1][2] == 31


@pytest.mark.parametrize("first", [True, False])
def test_of_two_echoes_of_ours_the_first_is_learned_from(first: bool) -> None:
    ears = Ears()
    ours = [Echo(OWN, 1_500_000 + i, 1_600_000 + i) for i in range(3)]
    echoes = (*ours, Echo(0, 1, 2)) if first else (Echo(0, 1, 2), *ours)
    ears.hear(sealed(word(head(echoes=echoes))))
    assert [lesson[1] for lesson in ears.native.fleet_clock.lessons] == [1.5]
    assert ears.native.usual == 1
    ears.same()


@pytest.mark.parametrize("turned", [True, False])
@pytest.mark.parametrize("differ", ["answered", "sent", "received"])
def test_of_what_comes_at_once_the_last_word_is_learned_from(differ: str, turned: bool) -> None:
    """Of each robot, whatever comes last, and whether the gate judges it or not."""
    ears = Ears()

    def need(made: Head) -> Message:
        return Need(made, 3, 29, 29, (29,) * N, ())

    pairs: list[tuple[Callable[[Head], Message], Callable[[Head], Message]]] = [
        (word, word),
        (word, need),
        (need, word),
    ]
    for kind, other in pairs:
        ears.move(10.0)
        stamps = [[3_000_000, 1_500_000, 1_600_000], [3_000_000, 1_500_000, 1_600_000]]
        stamps[1][["answered", "sent", "received"].index(differ)] += 5
        datagrams = []
        for number, (made, (answered, sent, received)) in enumerate(zip((kind, other), stamps, strict=True)):
            sequence = ears.native.link.sessions.newest[2] + 1 + number
            datagrams.append(sealed(made(head(2, sequence, sent=answered, echoes=(Echo(OWN, sent, received),)))))
        before = len(ears.native.fleet_clock.lessons)
        ears.hear(*datagrams[:: -1 if turned else 1], sealed(word(head(0, sequence, echoes=(Echo(OWN, 5, 6),)))))
        lessons = ears.native.fleet_clock.lessons[before:]
        (late,) = [lesson for lesson in lessons if lesson[0] == 2]
        assert late[1:4] == tuple(stamps[1][place] / 1e6 for place in (1, 2, 0)) and len(lessons) == 2
        ears.same()


def test_most_is_learned_from_who_keeps_the_time() -> None:
    """Also when it did not before: what it says next counts, however short ago it was learned from."""
    ears = Ears()
    for pid, sequence, after, learned in [(2, 71, 0.0, 1), (2, 72, 0.3, 1), (0, 71, 0.0, 2), (0, 72, 0.3, 3)]:
        ears.move(after)
        ears.hear(sealed(word(head(pid, sequence, echoes=(Echo(OWN, 1_500_000, 1_600_000),)))))
        assert len(ears.native.fleet_clock.lessons) == learned
    for ear in (ears.native, ears.plain):
        ear.link.keep_time(2, ear.clock.now())
    ears.hear(sealed(word(head(2, 73, echoes=(Echo(OWN, 1_500_000, 1_600_000),)))))
    assert len(ears.native.fleet_clock.lessons) == 4
    for ear in (ears.native, ears.plain):
        ear.link.keep_time(2, ear.clock.now())  # which is nothing new
    ears.hear(sealed(word(head(2, 74, echoes=(Echo(OWN, 1_500_000, 1_600_000),)))))
    assert len(ears.native.fleet_clock.lessons) == 4
    ears.same()


@pytest.mark.parametrize("pid", [N, 127, 128, 2**53])
def test_an_echo_of_nobody(pid: int) -> None:
    ears = Ears()
    found = ears.hear(sealed(word(head(echoes=(Echo(pid, 1, 2),)))))
    assert len(found) == (pid < 128)
    ears.same()


def test_more_echoes_than_there_may_be() -> None:
    ears = Ears()
    ears.hear(*[sealed(word(head(sequence=100 + k, echoes=(Echo(0, 1, 2),) * k))) for k in range(MAX_ECHOES + 3)])
    assert ears.native.usual == MAX_ECHOES + 1 and ears.native.link.rejected == {"malformed": 2}
    ears.same()


def test_as_many_as_can_be_taken_at_once() -> None:
    ears = Ears()
    words = [sealed(word(head(2, 100 + i), 30 + i)) for i in range(MOST_AT_ONCE)]
    Random(1).shuffle(words)
    assert len(ears.hear(*words)) == ears.native.usual == MOST_AT_ONCE
    ears.same()
    longest = [sealed(longest_word(2000 + i)) for i in range(MOST_AT_ONCE)]
    assert {len(datagram) for datagram in longest} == {LIMIT}
    assert len(ears.hear(*longest)) == MOST_AT_ONCE and ears.native.usual == 2 * MOST_AT_ONCE
    ears.same()
    with pytest.raises(ValueError, match="1024"):
        ears.native.hear(words * 2)


def longest_word(sequence: int) -> Round:
    echo = (Echo(OWN, 2**53, 2**53),)
    made = word(head(sequence=sequence, echoes=echo, fleet=-(2**53), sent=2**53), 2**53, applied=2**53, settled=2**53)
    closing = Closing(2, 200, 2**53, 2**53, writes=(Write(0, msgspec.Raw(b"\xc5" + (0).to_bytes(2, "big"))),))
    room = LIMIT - MAC_SIZE - len(pack(msgspec.structs.replace(made, closings=(closing,))))
    value = msgspec.Raw(b"\xc5" + room.to_bytes(2, "big") + bytes(room))
    return msgspec.structs.replace(made, closings=(msgspec.structs.replace(closing, writes=(Write(0, value),)),))


@needs_courier
def test_what_lies_in_the_couriers_slots_is_taken_from_there() -> None:
    """As the plain inbox's bytes are, without the own echoes; and it stays what it is when the slots are used anew."""
    usual = [sealed(word(head(2, 100 + i), 30 + i, [Closing(2, 200, 30 + i, 30 + i)])) for i in range(40)]
    echoes = [sealed(word(head(OWN, i))) for i in range(15)]
    sent = [*usual[:10], bytes(LIMIT + 1), echoes[0], usual[0], b"", *usual[10:], bytes(1500), *echoes[1:], usual[3]]
    sent[20] = sent[20][:-1] + b"x"
    found = []
    for native in (True, False):
        with inbox(native) as (made, _, sending, _):
            for echo in echoes:
                made.send(courier.GROUP, echo)
            ear, heard = Ear(native), []
            for batch in (sent, [b"\xff" * LIMIT] * 60, echoes, usual[5:9]):
                for datagram in batch:
                    sending[0].send(datagram)
                made.wait(PATIENCE)
                taken = made.receive()
                assert isinstance(taken, courier.Slots) == native
                if batch is echoes and native:
                    assert len(taken) == 15, "an echo comes back once"
                ear.waiting = taken
                heard.append(ear.link.receive())
            said = [[said for message in told for said in plain(message)] for told in heard]  # the slots are others now
            found.append((said, ear.link.rejected, ear.columns()))
            assert len(said[0]) == 39
    assert found[0] == found[1]
    assert found[0][1] == {"oversize": 2, "replayed": 6, "not authentic": 62, "not a peer": 15}


@needs_courier
def test_slots_of_own_echoes_alone_are_nothing() -> None:
    echo = sealed(word(head(OWN)))
    with inbox(True) as (made, _, sending, _):
        made.send(courier.GROUP, echo)
        sending[0].send(echo)
        made.wait(0.05)  # an echo wakes nobody
        ear, taken = Ear(True), made.receive()
        assert isinstance(made, courier.CompiledInbox) and made.slots.used == 1
        assert len(taken) == 0 and ear.hear(taken) == [] and ear.link.rejected == {}
        assert ear.hear(made.slots) == [] and ear.link.rejected == {}
        assert opened().take(made.slots, 1.0, None) == ([], ())
        sending[0].send(b"")
        made.wait(PATIENCE)
        assert ear.hear(made.receive()) == [] and ear.link.rejected == {"not authentic": 1}, "which is not nothing"


def test_macs_of_several_datagrams_side_by_side() -> None:
    """Of any lengths, of which some fill their last block; each is judged by its own."""
    ours, chance = opened(), Random(1)
    for count in [*range(1, 12)] * 20:
        payloads = [
            chance.randbytes(chance.choice((1, 63, 64, 65, 128, 320, LIMIT - 16, chance.randrange(1, LIMIT - 15))))
            for _ in range(count)
        ]
        datagrams, expected = [seal(KEY, MEMORY, payload) for payload in payloads], [OTHER] * count
        for place in range(count):
            damage = chance.random()
            if damage < 0.3:
                datagram, at = datagrams[place], chance.randrange(len(datagrams[place]))
                datagrams[place] = datagram[:at] + bytes([datagram[at] ^ 1 << chance.randrange(8)]) + datagram[at + 1 :]
                expected[place] = FALSE
            elif damage < 0.4:
                datagrams[place] = datagrams[place][: chance.randrange(17)]
                expected[place] = FALSE
            elif damage < 0.5:
                datagrams[place] = chance.randbytes(LIMIT + chance.randrange(1, 400))
                expected[place] = TOO_LONG
        assert verdicts(ours, datagrams) == expected


def test_a_library_of_another_layout_is_refused(tmp_path: Path) -> None:
    for wrong in ("MOST_AT_ONCE=1000", "MAX_ROBOTS=64", "WORDS=16"):
        name = wrong.partition("=")[0]
        flags = [f"-D{wrong}" if flag.startswith(f"-D{name}=") else flag for flag in gate.FLAGS]
        folder = tmp_path / name
        folder.mkdir(mode=0o700)
        if name != "WORDS":
            with pytest.raises(NotCompiled, match="lays its memory out otherwise"):
                load(gate.SOURCE, flags, gate.prove, folder)
        else:
            load(gate.SOURCE, flags, gate.prove, folder)


def test_without_a_library_the_link_hears_in_plain_Python(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate.COMPILED, "found", "there is no C compiler")
    assert gate.COMPILED.library() is None and gate.COMPILED.why() == "there is no C compiler"
    ear = Ear(True)
    assert ear.link._gate is None
    assert ear.hear([sealed(word(head()))]) and ear.usual == 0


@pytest.mark.slow
@needs_compiler
def test_sanitizers_find_nothing(tmp_path: Path) -> None:
    sanitized.run("gate_driver.c", gate.SOURCE, gate.FLAGS, tmp_path, 100_000)
