"""ARCHITECTURE.md: every name on it exists, and it answers the most frequent questions."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "ARCHITECTURE.md"
TEXT = PAGE.read_text(encoding="utf-8")
MOST_LINES, LONGEST = 160, 120
PLACE = re.compile(r"`([\w/.-]+\.py):([\w.]+)`")
DECISIONS = ROOT / "docs/adr"


@cache
def defined(path: str) -> frozenset[str]:
    """Return the dotted names of a module's functions, classes, methods and constants."""
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    found = {
        t.id for node in tree.body if isinstance(node, ast.Assign) for t in node.targets if isinstance(t, ast.Name)
    }

    def walk(body: list[ast.stmt], prefix: str) -> None:
        for node in body:
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
                found.add(prefix + node.name)
            if isinstance(node, ast.ClassDef):
                walk(node.body, f"{prefix}{node.name}.")

    walk(tree.body, "")
    return frozenset(found)


@cache
def all_defined() -> frozenset[str]:
    """Return all dotted names that the code of koordgen and targets defines."""
    files = [p for folder in ("koordgen", "targets") for p in (ROOT / folder).rglob("*.py")]
    return frozenset().union(*[defined(p.relative_to(ROOT).as_posix()) for p in files])


def rows() -> dict[str, tuple[str, str]]:
    """Return the rows of the table of properties: the place of each, and the remark."""
    table = TEXT.partition("## Enforced here")[2]
    cells = [line.strip("|").split(" | ") for line in table.splitlines() if line.startswith("| ")][1:]
    return {first.strip(): (where, remark.strip()) for first, where, remark in cells}


def steps() -> list[tuple[str, str]]:
    """Return (file, name) of each step of a walk and of each row of the table."""
    return PLACE.findall(TEXT)


def test_the_page_fits_on_three_screens() -> None:
    lines = TEXT.splitlines()
    assert len(lines) <= MOST_LINES
    assert not [line for line in lines if len(line) > LONGEST]


@pytest.mark.parametrize(("path", "name"), sorted(set(steps())), ids=str)
def test_each_function_that_the_page_names_is_there(path: str, name: str) -> None:
    assert (ROOT / path).is_file(), path
    assert name in defined(path)


def test_each_file_and_room_that_the_page_names_is_there() -> None:
    named = re.findall(r"`((?:koordgen|targets|tests|docs|templates|benchmarks|tools)/[\w/.-]*)`", TEXT)
    assert len(named) > 10
    assert not [path for path in named if not (ROOT / path).exists()]


def test_each_file_that_a_bundles_readme_names_is_in_the_bundle() -> None:
    named = re.findall(r"`(koordgen/runtime/[\w/]+\.py)`", (ROOT / "templates/README_agent.md.j2").read_text("utf-8"))
    assert "koordgen/runtime/vehicle/safety.py" in named
    assert not [path for path in named if not (ROOT / path).is_file()]


def test_the_table_has_a_function_in_each_row() -> None:
    found = rows()
    assert len(found) >= 36
    for question, (where, remark) in found.items():
        assert PLACE.fullmatch(where), question
        for name in re.findall(r"`([\w.]+)`", remark):
            assert name in all_defined() or name in ("peer_timeout", "while"), f"{question}: {name}"


@pytest.mark.parametrize(
    ("words", "place"),
    [
        ("geofence", "koordgen/runtime/vehicle/safety.py:clamp"),
        ("robot is dead", "koordgen/runtime/replication/views.py:choose"),
        ("`//` and `%` of negatives: emitted", "koordgen/build/emit/expr.py:_text"),
        ("NaN from an extern function", "koordgen/runtime/values/points.py:no_nan"),
        ("`--status`", "koordgen/runtime/ops/control.py:Control._part"),
        ("sent again", "koordgen/runtime/replication/replica.py:Replica._lacked_entries"),
        ("guard becomes SMT", "koordgen/verify/prove/obligations/generate.py:assume_guard"),
    ],
)
def test_a_question_takes_three_steps_from_the_readme(words: str, place: str) -> None:
    """README.md, the row of the table, the function."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert "Find something in the code: [ARCHITECTURE.md](ARCHITECTURE.md)" in readme
    file = place.rpartition(":")[0].rpartition("/")[2]
    name = place.rpartition(":")[2]
    places = [where for question, (where, _) in rows().items() if words in question]
    assert any(where.endswith(f"{file}:{name}`") for where in places), places


@pytest.mark.parametrize(
    ("term", "file"),
    [
        ("retransmission", "replication/retransmission.py"),
        ("state machine", "replication/replica.py"),
        ("state machine", "replication/state_machine.py"),
        ("failure detector", "replication/failure_detector.py"),
        ("view change", "replication/views.py"),
        ("state transfer", "replication/rejoin.py"),
        ("commit index", "replication/progress.py"),
        ("arbitration", "replication/apply.py"),
    ],
)
def test_the_standard_term_leads_to_its_module(term: str, file: str) -> None:
    module = ast.parse((ROOT / "koordgen/runtime" / file).read_text(encoding="utf-8"))
    assert term in (ast.get_docstring(module) or "").lower()


def test_the_list_of_decisions_is_complete() -> None:
    records = sorted(p for p in DECISIONS.glob("*.md") if p.name != "README.md")
    titles = {p.name: p.read_text(encoding="utf-8").splitlines()[0] for p in records}
    listed = re.findall(
        r"^- \[(\d{4}: [^\]]+)\]\(([^)]+)\)$", (DECISIONS / "README.md").read_text("utf-8"), re.MULTILINE
    )
    assert [(title, name) for title, name in listed] == [
        (re.sub(r"^# (ADR )?", "", title), name) for name, title in titles.items()
    ]
    for name, title in titles.items():
        assert re.match(rf"# (ADR )?{name[:4]}: ", title), name
    numbers = [name[:4] for name in titles]
    assert len(set(numbers)) == len(numbers)
