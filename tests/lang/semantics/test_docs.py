"""docs/reference/semantics.md names functions that are there."""

from __future__ import annotations

import ast
import re
from importlib import import_module
from pathlib import Path

WHOLE = (Path(__file__).parents[3] / "docs/reference/semantics.md").read_text(encoding="utf-8")
PAGE, CONDITIONS = WHOLE.split("## Verification conditions")
PROVER = sorted((Path(__file__).parents[3] / "koordgen/verify/prove").rglob("*.py"))
RULES = (
    "SELECTEVENT",
    "SKIPEVENT",
    "ENDEVENT",
    "ROBOTENV",
    "EVENTTRANS",
    "ENDPROGTRANS",
    "ENVTRANS",
    "Post",
    "End",
    "Reach",
)


def test_every_function_it_names_exists() -> None:
    named = re.findall(r"`([\w.]+)` in\s+`(\w+)\.py`", PAGE)
    assert len(named) > 30
    for path, module in named:
        thing: object = import_module(f"koordgen.lang.semantics.{module}")
        for name in path.split("."):
            thing = getattr(thing, name)
        assert (callable(thing) and thing.__doc__) or path in (
            "Run.block",
            "Run.statement",
            "Run.loop",
            "Run.assign",
        ), path


def test_every_published_rule_has_its_place() -> None:
    for rule in RULES:
        assert re.search(rf"^\| {rule}[ (:].*`\w+` in `\w+\.py`", PAGE, re.MULTILINE), rule
    assert "Post(C, ()) must be C" in PAGE


def defined() -> set[str]:
    """The functions and methods of the prover, as `name`, `Class.name`."""
    found: set[str] = set()
    for path in PROVER:
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
                found.add(node.name)
                parts = node.body if isinstance(node, ast.ClassDef) else []
                found.update(f"{node.name}.{m.name}" for m in parts if isinstance(m, ast.FunctionDef))
    return found


def test_every_verification_condition_names_functions_of_the_prover() -> None:
    rows = re.findall(r"^\| V(\d+) .*\| ([^|]+) \|$", CONDITIONS, re.MULTILINE)
    assert [int(number) for number, _ in rows] == list(range(1, 22))
    known = defined()
    for number, cell in rows:
        named = [name for name in re.findall(r"`([\w.]+)`", cell) if not name.endswith(".py")]
        assert named and set(named) <= known, f"V{number}: {set(named) - known}"


def test_every_rule_about_turns_stands_in_the_code() -> None:
    turns = next(p for p in PROVER if (p.parent.name, p.name) == ("encode", "stmt.py")).read_text(encoding="utf-8")
    rows = re.findall(r"^\| T\d ([\w ]+) \|", CONDITIONS, re.MULTILINE)
    assert len(rows) == 6
    for name in rows:
        assert f'# Rule "{name}"' in turns, name
