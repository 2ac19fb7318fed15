"""Names of koordgen/ and targets/: no retired words, and no public class name twice.

`python -m tests.test_names` prints what is left to rename.
"""

from __future__ import annotations

import ast
import re
from collections import Counter, defaultdict
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
}

# Uses of retired words that are left in each room: of the words in names, and of those in docstrings with the openers.
# The numbers may only become smaller; a room that is not listed has none.
LEFT: dict[str, tuple[int, int]] = {
    "koordgen/cli": (6, 0),
    "koordgen/experiment": (3, 0),
    "koordgen/lang": (8, 0),
    "koordgen/operate": (17, 9),
    "koordgen/runtime": (69, 5),
    "koordgen/verify": (42, 2),
    "targets/car": (41, 5),
    "targets/mavlink": (7, 0),
    "targets/planning": (4, 0),
    "targets/quad": (16, 1),
    "targets/sim": (75, 4),
}

# Rooms in which a class name may occur once each, with the reason.
PAIRED = {
    ("koordgen/lang/syntax/", "koordgen/lang/ir/"): "a construct has one name, in the syntax tree and in the IR",
}
# Public class names that may occur in several modules of one tree, with the reason.
REPEATED: dict[str, str] = {}
# Class names that still occur in several modules. Names are only taken away from this list.
STILL_REPEATED = {
    "koordgen": """
        Asked Asking Assumption Ball Bound Box Contract Entry Event Examined ExternType Fleet Folder Guard Init
        Known Library Log Mark Metrics Observation Parts Port Pose Program Property Record Rect Refused Session
        Shared Stop Stopped Stream Target Unknown Variable Verdict View World
    """,
    "targets": """
        Aim Asked Avoidance Car Limits Phase Route Seen State Track Way
    """,
}


class Use(NamedTuple):
    """Use of a retired word. `place`: file and line."""

    place: str
    room: str
    word: str
    text: str


def words(name: str) -> list[str]:
    """Split an identifier into lower-case words."""
    return [word.lower() for word in re.findall(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+", name)]


def room_of(path: str) -> str:
    """Return the room of a path: `koordgen/build/emit/expr.py` -> `koordgen/build`."""
    parts = path.split("/")
    return "/".join(parts[:2]) if len(parts) > 2 else parts[0]


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
                yield Use(f"{path}:{line}", room_of(path), word, name)


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
                yield Use(f"{path}:{getattr(node, 'lineno', 1)}", room_of(path), word, first)


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
    """Return the class names with several modules that no exception allows."""
    found = {}
    for name, places in classes(tree).items():
        pairs = [rooms for rooms in PAIRED if [sum(p.startswith(room) for p in places) for room in rooms] == [1, 1]]
        if len(places) > (2 if pairs else 1) and name not in REPEATED:
            found[name] = places
    return found


def over(uses: list[Use], part: int) -> str:
    """Return a message with the uses in each room that has more than LEFT allows; empty if none has."""
    by_room = defaultdict(list)
    for use in uses:
        by_room[use.room].append(use)
    lines = []
    for room, found in sorted(by_room.items()):
        most = LEFT.get(room, (0, 0))[part]
        if len(found) > most:
            lines.append(f"{room} has {len(found)} uses of retired words, at most {most} are allowed:")
            lines += [f"  {u.place}: {u.text!r} has {u.word!r}: {RETIRED.get(u.word, 'name it')}" for u in found]
    return "\n".join(lines)


def test_names_have_no_retired_words() -> None:
    assert not (message := over(list(uses_in_names()), 0)), message


def test_first_lines_of_docstrings_have_no_retired_words() -> None:
    assert not (message := over(list(uses_in_docstrings()), 1)), message


@pytest.mark.parametrize("tree", TREES)
def test_a_public_class_name_occurs_once(tree: str) -> None:
    still = STILL_REPEATED[tree].split()
    new = {name: places for name, places in repeated_classes(tree).items() if name not in still}
    assert not new, "\n".join(f"{name}: {', '.join(places)}" for name, places in sorted(new.items()))


def test_exceptions_are_needed() -> None:
    """Each exception is used, so the lists do not keep what was renamed."""
    texts = {path: {word for node in ast.walk(tree) for n in identifiers(node) for word in words(n)}
             for path, tree in modules().items()}  # fmt: skip
    for word, start in ALLOWED:
        assert word in RETIRED and any(word in found for path, found in texts.items() if path.startswith(start)), word
    repeated = {name for tree in TREES for name, places in classes(tree).items() if len(places) > 1}
    assert repeated >= set(REPEATED)


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


def test_what_is_over_is_printed(monkeypatch: pytest.MonkeyPatch) -> None:
    tree = ast.parse('class Told:\n  """What was told."""\n  def f(self, news): self.few = 1\n')
    path = "/".join(["koordgen", "new", "told.py"])
    monkeypatch.setattr(f"{__name__}.modules", lambda: {path: tree})
    lines = over(list(uses_in_names()), 0).split("\n")
    assert lines[0].startswith("koordgen/new has 4 uses") and len(lines) == 5
    assert any(line.startswith(f"  {path}:3: 'news' has 'news'") for line in lines)
    assert [use.word for use in uses_in_docstrings()] == ["What", "told"]


if __name__ == "__main__":
    names, docstrings = list(uses_in_names()), list(uses_in_docstrings())
    for use in (*names, *docstrings):
        print(f"{use.place}: {use.text!r} has {use.word!r}")
    counts = [Counter(use.room for use in uses) for uses in (names, docstrings)]
    for room in sorted({*counts[0], *counts[1]}):
        print(f'    "{room}": ({counts[0][room]}, {counts[1][room]}),')
    for tree in TREES:
        print(tree, " ".join(sorted(repeated_classes(tree))))
