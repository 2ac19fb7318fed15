"""`monitors` of the fleet file: names of the program's properties, actions that robots have, errors at their places."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import pytest

from koordgen.build.pipeline import Rejected, check_file, read_fleet
from koordgen.fleet import file as fleet
from koordgen.fleet import manifest
from koordgen.fleet.settings import NameChecks
from koordgen.lang.source import Source, Span
from koordgen.runtime.config.settings import Action
from koordgen.runtime.monitor.monitor import LOOPS

TARGETS = {name: manifest.load(name) for name in manifest.available()}
NAMES = ("Geofence", "assume Motion", "requires plan")
TEXT = """\
monitors: {MONITORS}
delta: 0.1
origin: {latitude: 47.0, longitude: 8.0, altitude: 400.0}
geofence: {lo: [-5, -5, -1], hi: [5, 5, 4]}
robots:
  - name: alice
    target: quad
    address: 127.0.0.1:47100
"""
CAR = "  - name: bert\n    target: car\n    address: 127.0.0.1:47101\n"


def read(monitors: str, more: str = "") -> tuple[dict[str, str] | None, list[tuple[str, int, int, str]]]:
    found: list[tuple[str, int, int, str]] = []

    def report(code: str, message: str, span: Span, help: str) -> None:
        found.append((code, span.line, span.column, f"{message} | {help}"))

    text = TEXT.replace("MONITORS", monitors) + more
    made = fleet.read(Source("fleet.yaml", text), TARGETS, {}, report, NameChecks(properties=NAMES))
    return (None if made is None else made.monitors), found


def test_the_actions_are_the_runtimes() -> None:
    assert get_args(Action) == fleet.MONITOR_ACTIONS


def test_what_it_says_is_taken() -> None:
    said = 'default: log, Geofence: hold, "assume Motion": land, requires plan: off'
    assert read(said) == (
        {"default": "log", "Geofence": "hold", "assume Motion": "land", "requires plan": "off"}, []
    )  # fmt: skip
    assert read("Geofence: stop", CAR) == ({"Geofence": "stop"}, [])


@pytest.mark.parametrize(
    ("monitors", "more", "code", "column", "words"),
    [
        ("Geofense: hold", "", "F002", 12, "did you mean 'Geofence'"),
        ("Geofence: halt", "", "F005", 22, "possible values: off, log, hold, land, stop"),
        ("Geofence: 1", "", "F004", 22, "must be a text"),
        ("Geofence: land", CAR, "F005", 22, "'land', which these robots cannot do: bert | use `stop`"),
        ("default: land", CAR, "F005", 21, "'land', which these robots cannot do: bert"),
        ("Geofence: hold, Geofence: log", "", "F006", 28, "appears twice"),
    ],
)
def test_each_mistake_at_its_place(monitors: str, more: str, code: str, column: int, words: str) -> None:
    made, found = read(monitors, more)
    assert made is None
    assert [(c, line, col) for c, line, col, _ in found] == [(code, 1, column)], found
    assert words in found[0][3]


LOOP = """\
local: int n
Go:
  pre: n == 0
  eff:
    while n < 3:
      invariant n <= 3
      n += 1
"""


def test_loop_invariants_have_one_name_where_the_program_has_some(tmp_path: Path) -> None:
    file = tmp_path / "fleet.yaml"
    file.write_text(TEXT.replace("MONITORS", f"{LOOPS}: hold"))
    for text, right in ((LOOP, True), (LOOP.replace("      invariant n <= 3\n", ""), False)):
        (tmp_path / "app.koord").write_text(text)
        program = check_file(str(tmp_path / "app.koord")).program
        if right:
            assert read_fleet(str(file), TARGETS, program, "app.koord")[0].monitors == {LOOPS: "hold"}
        else:
            with pytest.raises(Rejected):
                read_fleet(str(file), TARGETS, program, "app.koord")
