"""MACs of the compiled gate against hashlib: of one datagram, and of several side by side."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from hashlib import blake2s
from random import Random

import pytest

from benchmarks.fixtures.fleet import KEY
from koordgen.runtime.native.loader import load
from koordgen.runtime.net import gate
from koordgen.runtime.net.courier import MOST_AT_ONCE
from koordgen.runtime.net.gate import FALSE, OTHER, TOO_LONG, Gate
from koordgen.runtime.net.seal import CONTROL, MAC_SIZE, MEMORY, POSITION, seal
from koordgen.runtime.net.wire import LIMIT
from tests.runtime.net.compiled.gates import needs_gate, opened

pytestmark = needs_gate
OTHER_KEY = bytes(31) + b"\1"


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
