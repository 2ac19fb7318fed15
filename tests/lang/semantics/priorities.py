"""Random programs of three events with `priority:` blocks."""

from __future__ import annotations

import re
from random import Random

from tests.verify.explore.random_programs import program

OTHER = 1_000_000  # how far away the seed of the third event's program is
BLOCKS = ((0, 3), (0, 3), (0, 2), (1, 3))  # the events of a block, from and to


def ranked(seed: int) -> str:
    """The text of a random program with a third event and a `priority:` block of two or three of its events."""
    before, events, behind = _parts(program(seed))
    third = _parts(program(seed + OTHER))[1][0]
    events = [*events, third.replace("First:", "Third:", 1)]
    first, end = Random(seed).choice(BLOCKS)
    block = "".join(f"  {line}\n" for event in events[first:end] for line in event.splitlines())
    return "".join([before, *events[:first], "priority:\n", block, *events[end:], behind])


def in_one_block(text: str) -> str:
    """A program whose events, which stand together, are put into one `priority:` block."""
    sections = re.split(r"^(?=\S)", text, flags=re.MULTILINE)
    inside = [i for i, section in enumerate(sections) if "\n  pre:" in section]
    block = "".join("  " + line for i in inside for line in sections[i].splitlines(keepends=True) if line.strip())
    return "".join([*sections[: inside[0]], "priority:\n", block, *sections[inside[-1] + 1 :]])


def _parts(text: str) -> tuple[str, list[str], str]:
    """What stands before the two events of a program, its events, what stands behind."""
    before, first, rest = text.partition("First:\n")
    one, second, rest = rest.partition("Second:\n")
    two, behind, rest = rest.partition("initially:")
    return before, [first + one, second + two], behind + rest
