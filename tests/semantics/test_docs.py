"""docs/semantics.md names functions that are there."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

PAGE = (Path(__file__).parents[2] / "docs/semantics.md").read_text(encoding="utf-8")
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
        thing: object = import_module(f"koordgen.semantics.{module}")
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
