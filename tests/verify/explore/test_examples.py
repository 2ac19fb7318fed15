"""Every example is explored completely in its own environment without a violation: table in docs/examples.md."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.programs import programs_alone
from tests.verify.explore.mutants import EXAMPLES, MUTANTS
from tests.verify.explore.test_mutants import searched, surrounded

QUICK = {
    "atomicsum/atomicsum": "explore",
    "atomicsum/mutex": "explore",
    "crossing/crossing": "explore",
    "delivery/delivery": "explore",
    "election/election": "explore",
    "follow/follow": "explore",
    "hello/hello": "explore",
    "lineform/geofence": "explore",
    "lineform/lineform": "explore",
    "patrol/patrol": "explore",
    "task/separation": "explore_separation",
}
LONG = {
    "hvac/hvac": "explore",
    "mapping/mapping": "explore",
    "rendezvous/rendezvous": "explore",
    "task/once": "explore_once",
    "task/task": "explore",
}
ENDLESS = {  # each round brings a number that was not there before
    "formation/formation",  # an angle: it turns on and on
    "lineform/margin",  # a target: a fortieth of what is left
}


OF_FOUR = {
    "atomicsum/atomicsum": "explore",
    "crossing/crossing": "explore",
    "election/election": "explore",
    "hello/hello": "explore",
    "mapping/mapping": "explore_4",
    "patrol/patrol": "explore",
    "task/task": "explore_4",
}


def holds(example: str, env: str, tmp_path: Path, n_sys: int = 3) -> None:
    text = (EXAMPLES / f"{example}.koord").read_text()
    path = tmp_path / f"{Path(example).name}.koord"
    path.write_text(text + next((m.also for m in MUTANTS if m.program == example and m.also), ""))
    program, around = surrounded(path, env, example, n_sys)
    result = searched(program, around, EXAMPLES / f"{example}_functions.py", None, n_sys)
    assert result.violation is None and not result.stopped and not result.unseen


def test_no_example_is_left_out() -> None:
    found = {str(p.relative_to(EXAMPLES).with_suffix("")) for p in programs_alone()}
    assert found == set(QUICK) | set(LONG) | ENDLESS


@pytest.mark.parametrize("example", QUICK)
def test_it_is_explored(example: str, tmp_path: Path) -> None:
    holds(example, QUICK[example], tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("example", LONG)
def test_it_is_explored_if_not_at_once(example: str, tmp_path: Path) -> None:
    holds(example, LONG[example], tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("example", OF_FOUR)
def test_four_robots_are_explored(example: str, tmp_path: Path) -> None:
    holds(example, OF_FOUR[example], tmp_path, 4)
