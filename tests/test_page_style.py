"""The pages of the documentation are wrapped, with short paragraphs and a heading on each screen."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.test_pages import ROOT, our_pages, prose

WIDEST = 100  # columns; tables, listings and words that are longer alone cannot be wrapped
LONGEST_PARAGRAPH = 5  # lines
SCREEN = 50  # lines of a page from one heading to the next; a table counts as long as it is
WRITTEN_BY_CODE = {"grammar", "trace"}  # their tables and rules; `make generated`, `python -m tools.trace_tables`


def paragraphs(text: str) -> Iterator[list[str]]:
    """The paragraphs and items of lists of a page, as lines; without listings, tables and headings."""
    lines: list[str] = []
    for line in [*prose(text).splitlines(), ""]:
        begins = re.match(r"\s*([-*]|\d+\.) ", line)
        if (not line.strip() or begins or line.startswith(("|", "#", "<!--", "!["))) and lines:
            yield lines
            lines = []
        if line.strip() and not line.startswith(("|", "#", "<!--", "![")):
            lines.append(line)


@pytest.mark.parametrize("path", our_pages(), ids=str)
def test_a_page_is_wrapped(path: Path) -> None:
    text = (ROOT / path).read_text(encoding="utf-8")
    shown = prose(text).splitlines()
    for number, line in enumerate(text.splitlines()):
        if len(line) > WIDEST and not line.startswith(("|", "![")) and shown[number].strip():
            assert " " not in line.strip().removeprefix("- "), f"{path}:{number + 1}: {len(line)} columns"


@pytest.mark.parametrize("path", our_pages(), ids=str)
def test_paragraphs_are_short(path: Path) -> None:
    text = (ROOT / path).read_text(encoding="utf-8")
    long = [lines[0] for lines in paragraphs(text) if len(lines) > LONGEST_PARAGRAPH]
    assert not long, "\n".join([f"{path}:", *long])


@pytest.mark.parametrize("path", our_pages(), ids=str)
def test_each_screen_has_a_heading(path: Path) -> None:
    if path.stem in WRITTEN_BY_CODE:
        return
    lines = prose((ROOT / path).read_text(encoding="utf-8")).splitlines()
    headings = [n for n, line in enumerate(lines) if line.startswith("#")]
    gaps = {lines[a]: b - a for a, b in zip(headings, [*headings[1:], len(lines)], strict=True)}
    assert not {title: gap for title, gap in gaps.items() if gap > SCREEN}, path
