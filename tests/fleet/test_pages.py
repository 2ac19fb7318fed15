"""Pages about fleet files and shared memory: keys, messages and bounds agree with the code."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path
from typing import get_args

import pytest

from koordgen.build.bundle.budget import most_init
from koordgen.fleet import file as fleet
from koordgen.runtime.config.settings import Safety
from koordgen.runtime.net import wire

DOCS = Path(__file__).parents[2] / "docs"
MEMORY = (DOCS / "explanation/shared-memory.md").read_text(encoding="utf-8")
WIRE = (DOCS / "reference/wire.md").read_text(encoding="utf-8")
FLEET = (DOCS / "reference/fleet.md").read_text(encoding="utf-8")
BOUNDS = re.findall(r"^\| `(\w+)` in `([\w/]+)\.py` \| (\d+) \|", MEMORY, re.MULTILINE)
MESSAGES = dict(re.findall(r"^\| ([A-Z]\w+) \| (`.*?`) \|", WIRE, re.MULTILINE))


@pytest.mark.parametrize(("name", "module", "value"), BOUNDS)
def test_bounds_are_the_codes(name: str, module: str, value: str) -> None:
    assert getattr(import_module(f"koordgen.runtime.{module.replace('/', '.')}"), name) == int(value)


def test_every_message_has_its_fields() -> None:
    kinds = {kind.__name__: kind.__struct_fields__ for kind in get_args(wire.Message)}
    assert {name: re.findall(r"`(\w+)`", fields) for name, fields in MESSAGES.items()} == {
        name: [f for f in fields if f != "head"] for name, fields in kinds.items()
    }
    (head,) = re.findall(r"^Every message begins with a head: (.*?)\n\n", WIRE, re.MULTILINE | re.DOTALL)
    assert re.findall(r"`(\w+)`", head) == list(wire.Head.__struct_fields__)
    (entry,) = re.findall(r"^An entry is (.*?)\.\s", WIRE, re.MULTILINE | re.DOTALL)
    assert re.findall(r"`(\w+)`", entry) == list(wire.Entry.__struct_fields__)
    assert f"one byte of format ({wire.WIRE_FORMAT})" in " ".join(WIRE.split())


def test_the_room_of_init_is_said() -> None:
    assert f"{most_init(2)} bytes for two robots, {most_init(8)} for eight, {most_init(128)} for 128" in " ".join(
        MEMORY.split()
    )


def test_every_key_of_safety_is_documented_with_its_default() -> None:
    rows = dict(re.findall(r"^\| `(\w+)` \| `?([\w.]+)[^|]*\|", FLEET.partition("\n## Safety\n")[2], re.MULTILINE))
    assert {key: type(default)(rows[key]) for key, default in fleet.SAFETY.items()} == fleet.SAFETY
    assert set(rows) == set(Safety.__struct_fields__)
    text = " ".join(FLEET.split())
    assert f"at least {fleet.LEAST_TIMEOUT}" in text and f"`peer_timeout` + {fleet.GOING_ON}" in text


@pytest.mark.parametrize(
    "words",
    [
        "rounds in a row",
        "not count",
        "rejoining the mission",
        "removed from the fleet, asks to rejoin",
        "restarted without state during the mission and cannot rejoin",
    ],
)
def test_what_is_said_of_logs_is_what_robots_log(words: str) -> None:
    page = (DOCS / "reference/cli.md").read_text(encoding="utf-8").partition("### A robot is gone")[2]
    runtime = DOCS.parent / "koordgen" / "runtime"
    assert words in page
    assert any(words in path.read_text(encoding="utf-8") for path in runtime.rglob("*.py"))
