"""Names of koordgen/ and targets/: no retired words, and no public class name twice.

`python -m tests.test_names` prints what is left to rename.
"""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
TREES = ("koordgen", "targets")

# Retired words, with the term to use instead. A word counts in names of modules, classes, functions, parameters and
# attributes.
RETIRED = {
    "allowance": "CPU budget",
    "boots": "boot id",
    "certain": "committed",
    "closing": "log entry, round message",
    "comeback": "rejoin",
    "courier": "socket batch I/O",
    "crew": "agent handle, executor",
    "doubted": "suspected",
    "few": "the property that counts",
    "findings": "diagnostics, checks",
    "gone": "lost, stopped, removed",
    "keeping": "persistence",
    "know": "record, receive",
    "ledger": "replication table",
    "moment": "observation, state",
    "moments": "observations, states",
    "news": "failure detector, last message",
    "noticed": "diagnostics",
    "outbox": "output commit",
    "outcome": "apply, result",
    "patience": "timeout, retransmission policy",
    "rest": "safe stop",
    "rested": "stopped",
    "resting": "stopping",
    "said": "sent, reported",
    "say": "send, report, print",
    "says": "sends, reports",
    "scatter": "start perturbation",
    "sight": "ray casting",
    "slowed": "degraded",
    "speech": "codec, encoder",
    "surely": "screening",
    "take": "receive, apply, acquire",
    "takes": "receives, accepts",
    "tell": "send, report, print",
    "tells": "sends, reports",
    "told": "sent, delivered, reported",
    "upset": "fault state",
    "voice": "codec, encoder",
    "ways": "paths, alternatives",
}
# Those that count in first lines of docstrings as well. The others have plain uses there: "takes 3 ms", "the rest".
IN_TEXT = (
    "boots", "comeback", "courier", "crew", "doubted", "findings", "ledger", "news", "noticed", "outbox", "patience",
    "rested", "resting", "slowed", "speech", "surely", "tell", "tells", "told", "upset", "voice",
)  # fmt: skip
# Words that may not begin a docstring.
OPENERS = ("That", "What", "Whether", "Where", "Who")

# Allowed: (word, beginning of the path) -> reason.
ALLOWED = {
    ("closing", "koordgen/build/emit/layout.py"): "a closing bracket",
    ("certain", "koordgen/lang/analyze/facts/"): "iterations that a loop runs in any case; values without unknowns",
    ("ledger", "koordgen/verify/prove/report/"): "the assumption ledger of a proof, in the glossary",
    ("outcome", "koordgen/experiment/campaign/"): "the outcome of a run, a column of its table",
    ("outcome", "koordgen/lang/semantics/step.py"): "writes or fault of an event",
    ("outcome", "koordgen/runtime/monitor/"): "held, violated, no value or unknown",
    ("outcome", "koordgen/runtime/trace/"): "held, violated, no value or unknown",
    ("outcome", "koordgen/verify/audit/"): "held, violated, no value or unknown",
    ("outcome", "koordgen/verify/prove/report/"): "the verdict of an invariant",
    ("outcome", "targets/sim/judging/"): "held, violated, no value or unknown",
    ("outcome", "targets/sim/view/"): "event, skip or fault of a round",
    ("rest", "koordgen/lang/syntax/expr.py"): "the later comparisons of a chain",
    ("take", "koordgen/operate/deploy.py"): "to take over a lock",
    ("take", "targets/quad/autopilot/flight.py"): "to take over from a pilot",
    ("take", "targets/sim/autopilots/"): "take-off",
}

# Rooms in which a class name may occur once each, with the reason.
PAIRED = {
    ("koordgen/lang/syntax/", "koordgen/lang/ir/", "koordgen/runtime/program/"): (
        "a construct has one name: in the syntax tree, in the IR and in the runtime of generated programs"
    ),
    ("koordgen/lang/semantics/", "koordgen/runtime/values/"): "a value has one name: in the semantics and on robots",
}


class Use(NamedTuple):
    """Use of a retired word. `place`: file and line."""

    place: str
    word: str
    text: str


def words(name: str) -> list[str]:
    """Split an identifier into lower-case words."""
    return [word.lower() for word in re.findall(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+", name)]


@cache
def modules() -> dict[str, ast.Module]:
    """Return the syntax trees of all hand-written modules, by their path."""
    paths = [path for tree in TREES for path in sorted((ROOT / tree).rglob("*.py")) if "_generated" not in path.parts]
    return {path.relative_to(ROOT).as_posix(): ast.parse(path.read_text(encoding="utf-8")) for path in paths}


def identifiers(node: ast.AST) -> Iterator[str]:
    """Yield the names that a node defines: classes, functions, parameters and attributes."""
    match node:
        case ast.ClassDef(name=name, body=body):
            yield name
            for statement in body:
                if isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name):
                    yield statement.target.id
        case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.arg(arg=name):
            yield name
        case ast.Attribute(attr=name, ctx=ast.Store()):
            yield name


def names(path: str, tree: ast.Module) -> Iterator[str]:
    """Yield the names that a module defines, its own name first."""
    yield Path(path).stem
    for node in ast.walk(tree):
        yield from identifiers(node)


def is_allowed(word: str, path: str) -> bool:
    """Return whether ALLOWED has the word for this path."""
    return any(word == allowed and path.startswith(start) for allowed, start in ALLOWED)


def uses_in_names() -> Iterator[Use]:
    """Yield each definition of a name with a retired word; an attribute counts once in a module."""
    for path, tree in modules().items():
        found = {(word, Path(path).stem): 1 for word in words(Path(path).stem)}
        for node in ast.walk(tree):
            for name in identifiers(node):
                for word in words(name):
                    found.setdefault((word, name), getattr(node, "lineno", 1))
        for (word, name), line in found.items():
            if word in RETIRED and not is_allowed(word, path):
                yield Use(f"{path}:{line}", word, name)


def uses_in_docstrings() -> Iterator[Use]:
    """Yield each first line of a docstring with a retired word, or with an opener as its first word."""
    for path, tree in modules().items():
        for node in ast.walk(tree):
            if not isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
                continue
            first = (ast.get_docstring(node) or "").partition("\n")[0]
            opener = first.partition(" ")[0]
            wrong = [word for word in words(first) if word in IN_TEXT and not is_allowed(word, path)]
            for word in [*([opener] if opener in OPENERS else []), *wrong]:
                yield Use(f"{path}:{getattr(node, 'lineno', 1)}", word, first)


def classes(tree: str) -> dict[str, list[str]]:
    """Return the modules of each public class of a tree. Classes inside functions do not count."""
    found: dict[str, list[str]] = defaultdict(list)
    for path, module in modules().items():
        if not path.startswith(f"{tree}/"):
            continue
        waiting: list[ast.AST] = [module]
        while waiting:
            for node in ast.iter_child_nodes(waiting.pop()):
                if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                    found[node.name].append(path)
                if not isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                    waiting.append(node)
    return found


def repeated_classes(tree: str) -> dict[str, list[str]]:
    """Return the class names with several modules that PAIRED does not allow."""
    found = {}
    for name, places in classes(tree).items():
        counts = [[sum(place.startswith(room) for place in places) for room in rooms] for rooms in PAIRED]
        if len(places) > 1 and not any(max(count) == 1 and sum(count) == len(places) for count in counts):
            found[name] = places
    return found


def listed(uses: Iterator[Use]) -> str:
    """Return uses of retired words as text, one a line."""
    return "\n".join(f"{u.place}: {u.text!r} has {u.word!r}: {RETIRED.get(u.word, 'name it')}" for u in uses)


def test_names_have_no_retired_words() -> None:
    assert not (message := listed(uses_in_names())), message


def test_first_lines_of_docstrings_have_no_retired_words() -> None:
    assert not (message := listed(uses_in_docstrings())), message


@pytest.mark.parametrize("tree", TREES)
def test_a_public_class_name_occurs_once(tree: str) -> None:
    repeated = repeated_classes(tree)
    assert not repeated, "\n".join(f"{name}: {', '.join(places)}" for name, places in sorted(repeated.items()))


def test_exceptions_are_needed() -> None:
    """Each exception is used, so the list does not keep what was renamed."""
    texts = {path: {word for name in names(path, tree) for word in words(name)} for path, tree in modules().items()}
    for word, start in ALLOWED:
        assert word in RETIRED and any(word in found for path, found in texts.items() if path.startswith(start)), word


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("_news_of", ["news", "of"]),
        ("CannotTell", ["cannot", "tell"]),
        ("UDPGate2", ["udp", "gate"]),
        ("MOST", ["most"]),
    ],
)
def test_words_of_an_identifier(name: str, expected: list[str]) -> None:
    assert words(name) == expected


def test_what_is_retired_is_listed(monkeypatch: pytest.MonkeyPatch) -> None:
    tree = ast.parse('class Told:\n  """What was told."""\n  def f(self, news): self.few = 1\n')
    path = "/".join(["koordgen", "new", "told.py"])
    monkeypatch.setattr(f"{__name__}.modules", lambda: {path: tree})
    lines = listed(uses_in_names()).split("\n")
    assert len(lines) == 4 and f"{path}:3: 'news' has 'news': failure detector, last message" in lines
    assert [use.word for use in uses_in_docstrings()] == ["What", "told"]


if __name__ == "__main__":
    print(listed(uses_in_names()), listed(uses_in_docstrings()), sep="\n")
    for tree in TREES:
        print(tree, " ".join(sorted(repeated_classes(tree))))
