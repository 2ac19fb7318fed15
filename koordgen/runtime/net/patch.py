"""Patches between two encodings of a variable's value, for large values with small changes.

A patch is a MessagePack list of runs (keep, drop, put): keep the next `keep` bytes of the old encoding, drop the next
`drop` bytes, insert the bytes `put`. The rest of the old encoding is kept. Patches come from the network, so `patched`
never raises and never returns more bytes than allowed."""

from __future__ import annotations

import re

import msgspec

WORTH = 0.6  # largest length of a patch as a share of the new encoding; otherwise the whole value is sent

_GAP = re.compile(rb"\0{7,}")  # gap of equal bytes between two runs; a shorter gap costs less than a further run
_encoder = msgspec.msgpack.Encoder()
_decoder = msgspec.msgpack.Decoder(list[tuple[int, int, bytes]])


def difference(old: bytes, new: bytes) -> bytes | None:
    """Return the patch from `old` to `new`; None if it is not much shorter than `new`.

    The patch covers replaced bytes anywhere, and one place at which bytes were inserted or removed, as in a list that
    has grown or shrunk. Bytes behind that place are compared from the end."""
    shorter = min(len(old), len(new))
    if len(old) == len(new):
        tail = 0
    else:
        tail = shorter - len(_differing(old[len(old) - shorter :], new[len(new) - shorter :]).rstrip(b"\0"))
    before, after = old[: len(old) - tail], new[: len(new) - tail]
    aligned = min(len(before), len(after))
    runs: list[tuple[int, int, bytes]] = []
    done = 0  # number of bytes of `before` that the runs cover
    size = 0
    for start, end in _runs(_differing(before[:aligned], after[:aligned])):
        runs.append((start - done, end - start, after[start:end]))
        done = end
        size += end - start
        if size > WORTH * len(new):
            return None
    if len(before) != len(after):
        runs.append((aligned - done, len(before) - aligned, after[aligned:]))
    patch = _encoder.encode(runs)
    return patch if len(patch) <= WORTH * len(new) else None


def patched(old: bytes, patch: bytes, most: int) -> bytes | None:
    """Apply a patch to `old`. Return None if the patch is invalid or yields more than `most` bytes."""
    try:
        runs = _decoder.decode(patch)
    except (ValueError, RecursionError):
        return None
    parts: list[bytes] = []
    at, size = 0, 0
    for keep, drop, put in runs:
        if keep < 0 or drop < 0 or keep + drop > len(old) - at:
            return None
        parts += (old[at : at + keep], put)
        at += keep + drop
        size += keep + len(put)
        if size > most:
            return None
    return b"".join((*parts, old[at:])) if size + len(old) - at <= most else None


def _differing(a: bytes, b: bytes) -> bytes:
    """Return the XOR of two byte strings of equal length. A zero byte marks equal bytes."""
    return (int.from_bytes(a, "little") ^ int.from_bytes(b, "little")).to_bytes(len(a), "little")


def _runs(differing: bytes) -> list[tuple[int, int]]:
    """Return the ranges [start, end) of nonzero bytes, ascending; gaps below 7 zero bytes are included."""
    end = len(differing.rstrip(b"\0"))
    start = len(differing) - len(differing.lstrip(b"\0"))
    runs = []
    for gap in _GAP.finditer(differing, start, end):
        runs.append((start, gap.start()))
        start = gap.end()
    return [*runs, (start, end)] if start < end else runs
