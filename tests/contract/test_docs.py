"""docs/targets.md says what the manifests say, row by row."""

from __future__ import annotations

from pathlib import Path

import pytest

from koordgen.bundle import manifest

PAGE = (Path(__file__).parents[2] / "docs/targets.md").read_text(encoding="utf-8")


def rows(target: manifest.Target) -> list[str]:
    """The table rows that document a target's ports and settings."""
    ports = [
        f"| `{name}` | {direction} | `{koord_type}` |"
        for direction, offered in (("sensor", target.sensors), ("actuator", target.actuators))
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
        assert row in PAGE, f"docs/targets.md lacks:\n{row}"


def test_nothing_is_documented_that_is_not_there() -> None:
    known = {row for name in manifest.available() for row in rows(manifest.load(name))}
    documented = {line for line in PAGE.splitlines() if line.startswith("| `")}
    assert documented == known
