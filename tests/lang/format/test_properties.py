"""On all programs there are, and on random spellings of them: formatting changes no meaning, and settles at once."""

from __future__ import annotations

import random
import re
from itertools import pairwise
from pathlib import Path

import pytest

from koordgen.lang.diagnostics import InternalError
from koordgen.lang.format import formatted, same
from koordgen.lang.format.arrange import arranged, rows
from koordgen.lang.source import Source
from koordgen.lang.syntax.parse import parse

ROOT = Path(__file__).parents[3]
_BLOCK = re.compile(r"^```koord(?: prelude)?\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def programs() -> dict[str, str]:
    """Every program of the repository and of its pages that has no syntax errors, by its place."""
    found = {
        str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
        for folder in ("examples", "tests")
        for path in (ROOT / folder).rglob("*.koord")
    }
    pages = [*ROOT.glob("docs/**/*.md"), *ROOT.glob("tests/lang/*.md"), *ROOT.glob("koordgen/lang/explain/*.md")]
    for page in pages:
        text = page.read_text(encoding="utf-8")
        for block in _BLOCK.finditer(text):
            found[f"{page.name}:{text[: block.start()].count(chr(10)) + 2}"] = block[1]
    return {name: text for name, text in sorted(found.items()) if not parse(Source(name, text))[1]}


PROGRAMS = programs()


def tree(text: str) -> object:
    read, found = parse(Source("case.koord", text))
    assert found == [], f"{found}\n{text}"
    return read


def test_there_are_many() -> None:
    assert len(PROGRAMS) > 50
    assert sum(name.endswith(".koord") for name in PROGRAMS) > 5


@pytest.mark.parametrize("name", PROGRAMS)
def test_meaning_stays_and_comments_too(name: str) -> None:
    source = Source(name, PROGRAMS[name])
    text = formatted(source, tree(source.text))
    assert formatted(Source(name, text), tree(text)) == text
    assert comments(text) == comments(source.text)
    for line in text.split("\n"):
        assert line == line.rstrip()
    assert "\n\n\n" not in text
    assert not text.startswith("\n") and (text.endswith("\n") or not text) and not text.endswith("\n\n")


def comments(text: str) -> list[str]:
    """No program here has a `#` in a string."""
    return [line[line.index("#") :].rstrip() for line in text.split("\n") if "#" in line]


@pytest.mark.parametrize("name", PROGRAMS)
def test_other_spaces_make_no_difference(name: str) -> None:
    rng = random.Random(name)
    text = arranged(PROGRAMS[name])
    for _ in range(3):
        other = respaced(text, rng)
        assert same(tree(other), tree(text)), other
        assert arranged(other) == text, other


@pytest.mark.parametrize("name", PROGRAMS)
def test_other_lines_settle_at_once(name: str) -> None:
    rng = random.Random(name)
    meant = tree(PROGRAMS[name])
    for _ in range(3):
        other = scattered(PROGRAMS[name], rng)
        assert same(tree(other), meant), other
        text = formatted(Source(name, other), meant)
        assert arranged(text) == text, other
        assert [c.replace(" ", "") for c in comments(text)] == [c.replace(" ", "") for c in comments(other)]


def respaced(text: str, rng: random.Random) -> str:
    """The same lines with other spaces within them and other depths of blocks; but comments beside code, whose columns
    mean something, stand where they were."""
    depth = 2 if re.search("[^ \n].*#", text) else rng.choice([1, 2, 3, 5])
    result = []
    for line in text.split("\n"):
        code = line.lstrip(" ")
        start = " " * ((len(line) - len(code)) // 2 * depth)
        if "#" in code or "\\" in code:
            result.append(start + code)
        else:
            result.append(start + _respaced(code, rng) + " " * rng.choice([0, 0, 1, 3]))
    return "\n".join(result)


def _respaced(code: str, rng: random.Random) -> str:
    tokens = _tokens(code)
    parts = []
    for token, after in pairwise([*tokens, ""]):
        gap = " " * rng.choice([0, 0, 1, 2, 5])
        if after == "'":  # a prime
            gap = ""
        elif not gap and _tokens(token + after) != [t for t in (token, after) if t]:
            gap = " "
        parts += [token, gap if after else ""]
    return "".join(parts)


def _tokens(code: str) -> list[str]:
    return [token for row in rows(code) for token in row.tokens]


def scattered(text: str, rng: random.Random) -> str:
    """The same program with blank lines, comments and broken lines thrown in."""
    result: list[str] = []
    for line in text.split("\n"):
        while not (result and result[-1].endswith("\\")) and rng.random() < 0.2:
            result.append(" " * rng.randrange(8) + rng.choice(["", "# alone"]))
        code = line.rstrip()
        if code and not code.endswith("\\") and "#" not in code:
            code = _broken(code, rng)
            if rng.random() < 0.3:
                code += " " * rng.randrange(1, 4) + "# beside"
        result.append(code)
    return "\n".join(result) + "\n" * rng.randrange(3)


def _broken(code: str, rng: random.Random) -> str:
    """One line with some of its spaces made line ends: bare ones within brackets, else behind a backslash."""
    start = len(code) - len(code.lstrip())
    parts, depth, quote = [code[:start]], 0, ""
    for char in code[start:]:
        if quote or char in "\"'":  # a prime opens none, but then the line just stays as it is
            quote = "" if char == quote else quote or char
        depth += 0 if quote else (char in "([{") - (char in ")]}")
        if char == " " and not quote and rng.random() < 0.15:
            margin = " " * rng.randrange(1, 9)
            inside = rng.choice(["", " # inside", "\n", " \\"]) if depth > 0 else " \\"
            parts.append(f"{inside}\n{margin}")
        else:
            parts.append(char)
    return "".join(parts)


def test_a_formatter_that_changes_the_meaning_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    source = Source("a.koord", "param int a = 1 + 2\n")
    for wrong in ("param int a = 1 + 3\n", "param int b = 1 + 2\n", "param int a = 1 +\n", ""):
        monkeypatch.setattr("koordgen.lang.format.arranged", lambda text, wrong=wrong: wrong)
        with pytest.raises(InternalError, match=r"a\.koord"):
            formatted(source, tree(source.text))
