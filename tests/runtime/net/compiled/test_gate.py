"""The compiled gate against the link in plain Python: what is refused, and what it leaves to Python; and the library
that is not the one it should be. MACs are in test_mac.py, what the clock learns in test_lessons.py."""

from __future__ import annotations

from pathlib import Path
from random import Random
from typing import Any

import msgspec
import pytest

from benchmarks.fixtures.fleet import KEY
from koordgen.runtime.native.loader import NotCompiled, load
from koordgen.runtime.net import courier, gate
from koordgen.runtime.net.courier import MOST_AT_ONCE
from koordgen.runtime.net.seal import MAC_SIZE, MEMORY, seal
from koordgen.runtime.net.wire import (
    LIMIT,
    MAX_ECHOES,
    Closing,
    Echo,
    Hello,
    Round,
    Write,
    encoder,
    pack,
)
from tests.runtime.net.compiled import sanitized
from tests.runtime.net.compiled.gates import (
    ADOPTED,
    OWN,
    VIEW,
    Ear,
    Ears,
    N,
    head,
    needs_gate,
    opened,
    plain,
    sealed,
    word,
)
from tests.runtime.net.compiled.sanitized import needs_compiler
from tests.runtime.net.compiled.test_courier import inbox
from tests.runtime.net.transports import PATIENCE, needs_courier

pytestmark = needs_gate


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
