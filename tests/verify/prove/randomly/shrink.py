"""Shrinker: makes the text of a program small while a condition stays true, by lines and their blocks.

A line goes with the block below it, or a header goes and leaves its block, or an expression gives way to a part of it.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Iterator
from itertools import count

SIMPLER = (
    (r" and [^:]*$", ""), (r": .* and ", ": "), (r"pre: .*", "pre: True"), (r" = [^=].*", " = 0"),
    (r" = [^=].*", " = 7"), (r" = [^=].*", " = True"), (r"range\(.*\):", "range(9):"),
    (r"^(\s*)eff: atomic:", r"\1eff:"), (r"if .*: (.*)", r"\1"), (r"in range\(.*\):", "in ID:"), (r" (else|if) .*", ""),
)  # fmt: skip


def shrunk(text: str, still: Callable[[str], bool], tries: int = 400, seconds: float = math.inf) -> str:
    """The smallest text found of which `still` holds, as it does of `text`; `still` is asked `tries` times
    at most, and not after so many seconds."""
    budget, until = count(), time.monotonic() + seconds
    going = True
    while going:
        going = False
        for smaller in _smaller(text):
            if next(budget) >= tries or time.monotonic() > until:
                return text
            if smaller != text and still(smaller):
                text, going = smaller, True
                break
    return text


def _smaller(text: str) -> Iterator[str]:
    """Texts with something left out, those first that leave out most."""
    lines = text.split("\n")
    blocks = [(_end(lines, at), at) for at in range(len(lines)) if lines[at].strip()]
    for end, at in sorted(blocks, key=lambda b: b[1] - b[0]):
        yield "\n".join(lines[:at] + lines[end:])
        if lines[at].strip().endswith(":") and _indent(lines[at]) >= 2:
            yield "\n".join([*lines[:at], f"{' ' * _indent(lines[at])}pass", *lines[end:]])
    for end, at in blocks:
        if end > at + 1 and _indent(lines[at]) >= 2:
            inner = [line[2:] for line in lines[at + 1 : end]]
            yield "\n".join(lines[:at] + inner + lines[end:])
    for _, at in blocks:
        for pattern, to in SIMPLER:
            changed = re.sub(pattern, to, lines[at])
            if len(changed) < len(lines[at]):
                yield "\n".join([*lines[:at], changed, *lines[at + 1 :]])


def _end(lines: list[str], at: int) -> int:
    """Return the line at which the block of a line ends."""
    end = at + 1
    while end < len(lines) and lines[end].strip() and _indent(lines[end]) > _indent(lines[at]):
        end += 1
    return end


def _indent(line: str) -> int:
    return len(line) - len(line.lstrip())
