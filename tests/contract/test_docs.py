"""Pages agree with the code: ports and settings of targets, codes, and examples that compile."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from koordgen.fleet import manifest
from koordgen.lang.diagnostics import CATALOGUE
from tests.lang.test_lang import found, wanted

LANGUAGE = (Path(__file__).parents[2] / "docs/reference/language.md").read_text(encoding="utf-8")
PAGE = (Path(__file__).parents[2] / "docs/reference/targets.md").read_text(encoding="utf-8")


def rows(target: manifest.Target) -> list[str]:
    """Return the table rows that document a target's ports and settings."""
    ports = [
        f"| `{name}` | {direction} | `{koord_type}` |"
        for direction, offered in (
            ("sensor", target.sensors),
            ("actuator", target.actuators),
            ("callable", target.callables),
        )
        for name, koord_type in offered.items()
    ]
    settings = []
    for key, s in target.settings.items():
        bounds = f"{s.least:g} to {s.most:g}" if s.least is not None and s.most is not None else ""
        settings.append(f"| `{key}` | {s.type} | `{s.default}` | {bounds} | {s.doc} |")
    return ports + settings


@pytest.mark.parametrize("name", manifest.available())
def test_every_port_and_setting_is_documented(name: str) -> None:
    target = manifest.load(name)
    assert f"## {name}" in PAGE
    assert target.summary in PAGE
    for row in rows(target):
        assert row in PAGE, f"docs/reference/targets.md lacks:\n{row}"


def test_nothing_is_documented_that_is_not_there() -> None:
    known = {row for name in manifest.available() for row in rows(manifest.load(name))}
    documented = {line for line in PAGE.splitlines() if line.startswith("| `")}
    assert documented == known


def test_every_code_is_documented() -> None:
    root = Path(__file__).parents[2]
    page = (root / "docs/reference/errors.md").read_text(encoding="utf-8")
    documented = dict(re.findall(r"^\| ([KFB]\d{3}) \| (.+) \|$", page, re.MULTILINE))
    used = {
        code
        for path in (root / "koordgen").rglob("*.py")
        if path.name != "diagnostics.py"
        for code in re.findall(r'"([FB]\d{3})"', path.read_text(encoding="utf-8"))
    }
    assert documented == CATALOGUE
    assert used == {code for code in CATALOGUE if not code.startswith("K")}


EXAMPLES = re.findall(r"^```koord\n(.*?)^```$", LANGUAGE, re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("number", range(len(EXAMPLES)))
def test_an_example_of_the_language_page_does_what_it_says(number: int) -> None:
    text = EXAMPLES[number]
    missed = wanted(text)
    for diagnostic in found(text):
        match = [w for w in missed if w[:3] == (diagnostic.span.line, diagnostic.severity, diagnostic.code)]
        assert match, (diagnostic.span.line, diagnostic.code, diagnostic.message)
        missed.remove(match[0])
    assert not missed
