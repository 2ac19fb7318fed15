"""Runs the literate tests: every program of every Markdown file here finds what its comments say, and no more."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from koordgen.lang.analyze.program import check
from koordgen.lang.diagnostics import CATALOGUE, Diagnostic, together
from koordgen.lang.ir.printer import show
from koordgen.lang.ir.verify import verify
from koordgen.lang.source import Source
from koordgen.lang.syntax.parse import parse

HERE = Path(__file__).parent
_BLOCK = re.compile(r"^```koord( prelude)?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_WANTED = re.compile(r"(error|warning|note): \[(K\d{3})\] ?([^;]*)")


class Case(NamedTuple):
    """One program; `file:line` is where its block begins."""

    name: str
    text: str


def cases() -> Iterator[Case]:
    for path in sorted(HERE.glob("*.md")):
        text = path.read_text(encoding="utf-8")
        prelude = ""
        for block in _BLOCK.finditer(text):
            line = text[: block.start()].count("\n") + 2
            if block[1]:
                prelude = block[2]
            else:
                yield Case(f"{path.name}:{line}", prelude + block[2])


CASES = list(cases())


def found(text: str) -> list[Diagnostic]:
    """Everything the front end has to say of a program; a right one is verified and printed as well."""
    source = Source("case.koord", text)
    tree, unread = parse(source)
    program, diagnostics = check(tree, source)
    assert (program is None) == any(d.severity == "error" for d in diagnostics)
    if program is not None and not unread:
        verify(program)
        assert show(program)
    return together(unread, diagnostics)


def wanted(text: str) -> list[tuple[int, str, str, str]]:
    return [
        (number, severity, code, message.strip())
        for number, line in enumerate(text.split("\n"), 1)
        for severity, code, message in _WANTED.findall(line.partition("#")[2])
    ]


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.name)
def test_finds_what_its_comments_say(case: Case) -> None:
    left = found(case.text)
    for line, severity, code, message in wanted(case.text):
        match = [
            d for d in left if (d.span.line, d.severity, d.code) == (line, severity, code) and message in d.message
        ]
        assert match, (
            f"line {line}: no {severity}[{code}] {message!r} in {[(d.span.line, d.code, d.message) for d in left]}"
        )
        left = [d for d in left if d is not match[0]]
    assert not left, [(d.span.line, d.code, d.message) for d in left]


def test_every_code_is_shown_and_has_a_near_miss() -> None:
    """A section that shows a code also holds a program that is right."""
    shown: set[str] = set()
    for path in HERE.glob("*.md"):
        for section in re.split(r"^## ", path.read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]:
            blocks = [block[2] for block in _BLOCK.finditer(section) if not block[1]]
            codes = {code for block in blocks for _, _, code, _ in wanted(block)}
            right = [block for block in blocks if not wanted(block)]
            assert right or not codes, f"{path.name}, section {section.splitlines()[0]!r}: no near miss"
            shown |= codes
    assert shown == {code for code in CATALOGUE if code.startswith("K")}
