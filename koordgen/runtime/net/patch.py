"""What changed between two encodings of one variable's value, for values that are large and change little.

A patch is MessagePack of a list of runs (keep, drop, put): keep so many bytes of the old encoding, drop the next so
many, put these in their place; what is left of the old one is kept. Patches are made by robots and applied to what
the network brought, so applying one never raises and never makes more bytes than it is allowed to.
"""

from __future__ import annotations

import re

import msgspec

WORTH = 0.6  # a patch longer than this part of the new encoding is none: applying it costs time as well

_GAP = re.compile(rb"\0{7,}")  # equal bytes between two runs: fewer cost less than another run's header
_encoder = msgspec.msgpack.Encoder()
_decoder = msgspec.msgpack.Decoder(list[tuple[int, int, bytes]])


def difference(old: bytes, new: bytes) -> bytes | None:
    """The patch that makes `new` of `old`; None when it is not much shorter than `new`.

    Found are changes in place, wherever they are, and one place at which the length changes (a list that grows or
    shrinks: its header, in place, and the elements). What comes behind that place is compared from the end.
    """
    shorter = min(len(old), len(new))
    if len(old) == len(new):
        tail = 0
    else:
        tail = shorter - len(_differing(old[len(old) - shorter :], new[len(new) - shorter :]).rstrip(b"\0"))
    before, after = old[: len(old) - tail], new[: len(new) - tail]
    aligned = min(len(before), len(after))
    runs: list[tuple[int, int, bytes]] = []
    done = 0  # bytes of `before` that the runs so far account for
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
    """`old` with a patch applied; None when the patch is none, does not fit `old`, or would make more than `most`
    bytes."""
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
    """Of two strings of one length: zero where they are equal."""
    return (int.from_bytes(a, "little") ^ int.from_bytes(b, "little")).to_bytes(len(a), "little")


def _runs(differing: bytes) -> list[tuple[int, int]]:
    """Where there are differences, as [start, end) without equal bytes at either end, ascending."""
    end = len(differing.rstrip(b"\0"))
    start = len(differing) - len(differing.lstrip(b"\0"))
    runs = []
    for gap in _GAP.finditer(differing, start, end):
        runs.append((start, gap.start()))
        start = gap.end()
    return [*runs, (start, end)] if start < end else runs
