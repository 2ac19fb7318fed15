"""Whatever is fed to the front end: diagnostics or a program that works, never an exception, never a hang."""

from __future__ import annotations

import random
import re
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from koordgen.lang.diagnostics import Diagnostic, render, together
from koordgen.lang.node import Node
from koordgen.lang.source import Source
from koordgen.lang.syntax.decl import Program
from koordgen.lang.syntax.parse import parse

ROOT = Path(__file__).parents[3]
SLOWEST = 20.0  # seconds for one text, on a machine that is busy with other things; hanging takes longer

_MARKS = "( ) [ ] { } : , . = == != < <= > >= + - * / // % ** << -> += ' \" \\ # ; ! && || & | ~ ? @ $"
_WORDS = """pid N_SYS ID x total 0 1 2.5 1e9 9999999999999999999 True 'text' "text" Point( Motion.position
    using sensors: actuators: assume param allread: allwrite: local: init: pre: eff: def fun extern spec type axiom
    invariant initially: forall exists if elif else: for while break continue return atomic: pass stop and or not in
    max requires: ensures: List< Map< Set< Queue< int float bool string List<int> Set<int>"""
_SPACES = ["\n", "\n  ", "\n    ", "      ", "\t", "\0", "\r", "\u2028", "\ufeff", "# c\n", "é", "\U0001f98a"]
PIECES = [*_MARKS.split(), *_WORDS.split(), *_SPACES]
_WORD = re.compile(r"\w+|\s+|[^\w\s]")

Words = list[str]
Mutation = Callable[[random.Random, Words, list[str]], None]


def corpus() -> list[str]:
    """Every program that stands in examples, goldens and literate tests."""
    files = [*ROOT.glob("examples/*/*.koord"), *ROOT.glob("tests/golden/*/*.koord")]
    texts = [path.read_text(encoding="utf-8") for path in sorted(files)]
    for page in [*sorted((ROOT / "tests/lang").glob("*.md")), ROOT / "docs/reference/language.md"]:
        texts += re.findall(r"^```koord[^\n]*\n(.*?)^```$", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    return texts


def _place(chance: random.Random, words: Words) -> int:
    return chance.randrange(len(words)) if words else 0


def _delete(chance: random.Random, words: Words, _: list[str]) -> None:
    at = _place(chance, words)
    del words[at : at + chance.choice((1, 1, 1, 2, 8))]


def _double(chance: random.Random, words: Words, _: list[str]) -> None:
    at = _place(chance, words)
    words[at:at] = words[at : at + chance.choice((1, 1, 2, 12))]


def _swap(chance: random.Random, words: Words, _: list[str]) -> None:
    if words:
        a, b = _place(chance, words), _place(chance, words)
        words[a], words[b] = words[b], words[a]


def _insert(chance: random.Random, words: Words, _: list[str]) -> None:
    words.insert(_place(chance, words), chance.choice(PIECES))


def _flip(chance: random.Random, words: Words, _: list[str]) -> None:
    """One byte of a word becomes another; what is no UTF-8 then is read as some other character."""
    if words:
        at = _place(chance, words)
        raw = bytearray(words[at].encode())
        raw[chance.randrange(len(raw))] ^= 1 << chance.randrange(8)
        words[at] = raw.decode("latin-1")


def _splice(chance: random.Random, words: Words, texts: list[str]) -> None:
    other = _WORD.findall(chance.choice(texts))
    at, start = _place(chance, words), _place(chance, other)
    words[at : at + chance.choice((0, 20, len(words)))] = other[start : start + chance.choice((20, 200, len(other)))]


def _indent(chance: random.Random, words: Words, _: list[str]) -> None:
    ends = [i for i, word in enumerate(words) if "\n" in word]
    if ends:
        words[chance.choice(ends)] = "\n" + chance.choice((" ", "\t", "\r")) * chance.randrange(9)


EVERYDAY: list[Mutation] = [_delete, _delete, _double, _swap, _insert, _insert, _flip, _splice, _indent]


DEEP = [("(", ")"), ("[", "]"), ("{", "}"), ("x[", "]"), ("f(", ")"), ("List<", ">"), ("-", ""), ("not ", ""),
        ("while x: ", ""), ("forall i in ID: ", ""), ("x if x else ", "")]  # fmt: skip


def _deep(chance: random.Random, words: Words, _: list[str]) -> None:
    opens, closes = chance.choice(DEEP)
    count = 1000
    words.insert(_place(chance, words), opens * count + "1" + closes * chance.choice((0, count - 1, count)))


def _long(chance: random.Random, words: Words, _: list[str]) -> None:
    words.insert(_place(chance, words), chance.choice(PIECES) * chance.choice((1_000, 100_000)))


RARE: list[Mutation] = [_deep, _long]


def mutated(chance: random.Random, texts: list[str]) -> str:
    words = _WORD.findall(chance.choice(texts))
    for _ in range(chance.choice((1, 1, 2, 3, 6))):
        chance.choice(EVERYDAY if chance.random() < 0.997 else RARE)(chance, words, texts)
    text = "".join(words)
    match chance.randrange(40):
        case 0:
            return text.replace("\n", "\r\n")
        case 1:
            return text.rstrip("\n")
        case 2:
            return text[: chance.randrange(len(text) + 1)]
    return text


def is_broken(tree: Node) -> bool:
    """Whether some part of a tree could not be read."""
    pending: list[Any] = [tree]
    while pending:
        node = pending.pop()
        if isinstance(node, tuple):
            pending.extend(node)
        elif isinstance(node, Node):
            if type(node).__name__.startswith("Broken"):
                return True
            pending.extend(getattr(node, field) for field in type(node).__match_args__ if "span" not in field)  # type: ignore[attr-defined]
    return False


def lies_in(found: Diagnostic, source: Source) -> bool:
    """Whether what a diagnostic points at is in the text; behind a line's last character counts as in."""
    span = found.span
    last = source.text.count("\n") + 1
    return (
        1 <= span.line <= span.end_line <= last
        and 1 <= span.column <= len(source.line(span.line)) + 1
        and span.end_column <= len(source.line(span.end_line)) + 2
        and (span.line, span.column) <= (span.end_line, span.end_column)
    )


def feed(text: str) -> str:
    """The front end as `koordgen build` runs it: how far the text came."""
    source = Source("fuzz.koord", text)
    tree, found = parse(source)
    assert all(lies_in(d, source) for d in found), found
    assert len({(d.span.line, d.span.column, d.code) for d in found}) == len(found)
    if found:
        assert render(found[0], source)
    else:
        assert not is_broken(tree)
    return built(tree, source, found)


def built(tree: Program, source: Source, found: list[Diagnostic]) -> str:
    from koordgen.build.emit.program import program_text
    from koordgen.lang.analyze.program import check
    from koordgen.lang.ir.verify import verify

    program, more = check(tree, source)
    told = together(found, more)  # in a line that could not be read the checker's word is an echo
    assert all(lies_in(d, source) for d in told), told
    if program is None or found:
        assert any(d.severity == "error" for d in [*found, *more])
        return "unread" if found else "read"
    verify(program)
    compile(program_text(program), "program.py", "exec")
    return "right"


def fuzz(count: int, seed: int) -> Counter[str]:
    texts = corpus()
    came: Counter[str] = Counter()
    chance = random.Random(seed)
    slowest = 0.0
    for _ in range(count):
        text = mutated(chance, texts)
        start = time.perf_counter()
        try:
            came[feed(text)] += 1
        except Exception as error:
            raise AssertionError(f"{type(error).__name__}: {error}; the text: {text[:20_000]!r}") from error
        slowest = max(slowest, time.perf_counter() - start)
    assert slowest < SLOWEST
    return came


def test_every_program_of_ours_is_fed() -> None:
    assert len(corpus()) > 50
    assert sum(feed(text) != "unread" for text in corpus()) > 40


def test_no_mutation_raises_or_hangs() -> None:
    came = fuzz(2_000, seed=20261121)
    assert came["unread"] > 500
    assert came["read"] > 50 and came["right"] > 10  # the mutations do not only destroy


@pytest.mark.slow
@pytest.mark.parametrize("part", range(10))
def test_no_mutation_of_200000_raises_or_hangs(part: int) -> None:
    fuzz(20_000, seed=part)


@pytest.mark.parametrize(
    "raw",
    [
        b"\xff\xfe\x00",
        "E:\n".encode("utf-16"),
        b"E:\n  pre: \x80\n",
        b"\xc3",
        "E: é".encode("latin-1"),
        b"\xed\xa0\x80",
    ],
)
def test_a_file_that_is_no_utf_8_is_told(raw: bytes, tmp_path: Path) -> None:
    from koordgen.build.pipeline import Rejected, read_source

    path = tmp_path / "a.koord"
    path.write_bytes(raw)
    with pytest.raises(Rejected) as rejected:
        read_source(str(path))
    assert [d.code for _, d in rejected.value.found] == ["F101"]


@pytest.mark.parametrize("text", corpus()[:8])
def test_a_byte_order_mark_and_windows_line_ends_change_nothing(text: str, tmp_path: Path) -> None:
    from koordgen.build.pipeline import read_source

    path = tmp_path / "a.koord"
    path.write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
    assert parse(read_source(str(path))) == parse(Source("a.koord", text))


@pytest.mark.parametrize("size", [100_000, pytest.param(1_000_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("piece", ["x + ", "x.", "x", " ", "(", '"', "= ", "# ", "if x: ", "x\\\n", "x = [\n", "max "])
def test_a_line_of_a_megabyte_takes_seconds_at_most(piece: str, size: int) -> None:
    line = piece * (size // len(piece))
    start = time.perf_counter()
    feed(f"local: int x\nE:\n  pre: True\n  eff:\n    x = {line}\n    x = 2\n")
    assert time.perf_counter() - start < SLOWEST
