"""Authentication of all network data: keyed BLAKE2s over the whole datagram.

No caller reads a datagram before `unseal` has accepted it. `purpose` separates protocols that share a key: a datagram
of one protocol is not authentic in another."""

from __future__ import annotations

import stat
from collections.abc import Callable
from functools import lru_cache
from hashlib import blake2s
from hmac import compare_digest
from pathlib import Path

KEY_SIZE = 32
MAC_SIZE = 16
MEMORY = b"k-memory"  # shared memory between agents
POSITION = b"k-pose"  # position feed from a base station
SCAN = b"k-scan"  # scans from a lidar
CONTROL = b"k-contrl"  # control commands from operators: emergency stop, status


class BadKey(Exception):
    """A key file that must not be used. The message says why, and how to fix it."""


def load_key(path: Path) -> bytes:
    """Return the fleet's key.

    Raises BadKey if the file is missing, of a wrong size, or readable by others."""
    try:
        mode = path.stat().st_mode
        key = path.read_bytes()
    except OSError as error:
        raise BadKey(
            f"{path}: {error.strerror or error}; copy the fleet's key there "
            "(one for all its robots; `koordgen key new FILE` makes it)"
        ) from None
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise BadKey(f"{path}: others may read it; run `chmod 600 {path}`")
    if len(key) != KEY_SIZE:
        raise BadKey(f"{path}: {len(key)} bytes where a key has {KEY_SIZE}; make one with `koordgen key new`")
    return key


def seal(key: bytes | None, purpose: bytes, payload: bytes) -> bytes:
    """Return the payload with its MAC. Without a key (`insecure: true`) it detects damage, not forgery."""
    state = _keyed(key or b"", purpose).copy()
    state.update(payload)
    return payload + state.digest()


def unseal(key: bytes | None, purpose: bytes, datagram: bytes) -> bytes | None:
    """Return the payload of an authentic datagram, or None."""
    return unsealer(key, purpose)(datagram)


@lru_cache(maxsize=16)
def unsealer(key: bytes | None, purpose: bytes) -> Callable[[bytes], bytes | None]:
    """Return `unseal` for one key and purpose."""
    new_hash = _keyed(key or b"", purpose).copy

    def unseal_(datagram: bytes) -> bytes | None:
        payload = datagram[:-MAC_SIZE]
        state = new_hash()
        state.update(payload)
        return payload if payload and compare_digest(datagram[-MAC_SIZE:], state.digest()) else None

    return unseal_


@lru_cache(maxsize=16)
def _keyed(key: bytes, purpose: bytes) -> blake2s:
    """Return a hash that already includes the key: that saves one block of the few of a datagram."""
    return blake2s(digest_size=MAC_SIZE, key=key, person=purpose)
