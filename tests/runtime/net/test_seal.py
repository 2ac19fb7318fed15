"""MACs: what is sealed, and what is taken for genuine."""

from __future__ import annotations

import random
from hashlib import blake2s

import pytest

from koordgen.runtime.net.seal import CONTROL, MAC_SIZE, MEMORY, POSITION, seal, unseal

KEYS = [bytes(range(32)), bytes(32), None]


@pytest.mark.parametrize("key", KEYS)
@pytest.mark.parametrize("purpose", [MEMORY, POSITION])
def test_every_length_is_sealed_and_unsealed(key: bytes | None, purpose: bytes) -> None:
    chance = random.Random(1)
    payloads = [chance.randbytes(length) for length in range(1, 1301)]
    sealed = [seal(key, purpose, payload) for payload in payloads]
    for payload, datagram in zip(payloads, sealed, strict=True):
        mac = blake2s(payload, digest_size=MAC_SIZE, key=key or b"", person=purpose).digest()
        assert datagram == payload + mac
    assert [unseal(key, purpose, datagram) for datagram in sealed] == payloads


def test_what_is_not_genuine_is_none_beside_what_is() -> None:
    chance, key = random.Random(2), KEYS[0]
    good = [seal(key, MEMORY, chance.randbytes(chance.randint(1, 300))) for _ in range(200)]
    at = [chance.randrange(len(datagram)) for datagram in good]
    flipped = [d[:i] + bytes([d[i] ^ 1 << chance.randrange(8)]) + d[i + 1 :] for d, i in zip(good, at, strict=True)]
    shorter = [datagram[:i] for datagram, i in zip(good, at, strict=True)]
    others = [seal(other, MEMORY, b"x") for other in (*KEYS[1:], bytes(31))]
    bad = [*flipped, *shorter, *others, seal(key, CONTROL, b"x"), seal(key, MEMORY, b""), b"", bytes(MAC_SIZE)]
    mixed = [(d, True) for d in good] + [(d, False) for d in bad]
    chance.shuffle(mixed)
    assert [unseal(key, MEMORY, d) for d, _ in mixed] == [d[:-MAC_SIZE] if genuine else None for d, genuine in mixed]
