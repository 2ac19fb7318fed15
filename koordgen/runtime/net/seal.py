"""Authentication of all network data: a keyed BLAKE2s MAC over the whole datagram.

Callers read a datagram only after `unseal` has accepted it. Protocols that share a key have different `purpose` values,
so a datagram of one protocol is not authentic in another protocol."""

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
    """Raised for a key file that must not be used. The message says why, and how to fix the file."""


def load_key(path: Path) -> bytes:
    """Read the fleet's key from a file.

    Raises BadKey if the file is missing, has a wrong size, or can be accessed by other users."""
    try:
        mode = path.stat().st_mode
        key = path.read_bytes()
    except OSError as error:
        raise BadKey(
            f"{path}: {error.strerror or error}; copy the fleet's key there "
            "(all robots use one key; `koordgen key new FILE` makes a key)"
        ) from None
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise BadKey(f"{path}: other users may read it; run `chmod 600 {path}`")
    if len(key) != KEY_SIZE:
        raise BadKey(f"{path}: the file has {len(key)} bytes, a key has {KEY_SIZE}; make a key with `koordgen key new`")
    return key


def seal(key: bytes | None, purpose: bytes, payload: bytes) -> bytes:
    """Return payload and MAC. Without a key (`insecure: true`), the MAC detects damage, not forgery."""
    state = _keyed(key or b"", purpose).copy()
    state.update(payload)
    return payload + state.digest()


def unseal(key: bytes | None, purpose: bytes, datagram: bytes) -> bytes | None:
    """Return the payload of a datagram, or None if the datagram is not authentic."""
    return unsealer(key, purpose)(datagram)


@lru_cache(maxsize=16)
def unsealer(key: bytes | None, purpose: bytes) -> Callable[[bytes], bytes | None]:
    """Return the function `unseal` with `key` and `purpose` bound to it."""
    new_hash = _keyed(key or b"", purpose).copy

    def unseal_(datagram: bytes) -> bytes | None:
        payload = datagram[:-MAC_SIZE]
        state = new_hash()
        state.update(payload)
        return payload if payload and compare_digest(datagram[-MAC_SIZE:], state.digest()) else None

    return unseal_


@lru_cache(maxsize=16)
def _keyed(key: bytes, purpose: bytes) -> blake2s:
    """Return a hash object that has already hashed the key, so that each datagram takes one block less."""
    return blake2s(digest_size=MAC_SIZE, key=key, person=purpose)
