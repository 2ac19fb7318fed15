"""The network of the fleet file in the robots' bundles."""

from __future__ import annotations

import json

import pytest

from koordgen.build.bundle.plan import Files, plan, read_ingredients
from koordgen.build.pipeline import check_file
from koordgen.fleet import file as fleet
from koordgen.fleet import manifest
from koordgen.lang import resources
from koordgen.lang.source import Source
from tests.golden.test_golden import PROGRAMS

PROGRAM, FLEET = PROGRAMS["lineform"]


def bundles(network: str) -> dict[str, Files]:
    targets = {n: manifest.load(n) for n in manifest.available()}
    source = Source("fleet.yaml", FLEET.read_text() + network)
    read = fleet.read(source, targets, {}, lambda *told: pytest.fail(str(told)))
    checked = check_file(str(PROGRAM)).program
    ingredients = read_ingredients(checked, PROGRAM.read_bytes(), tuple(targets.values()), read, resources.package())
    return plan(ingredients, list(targets))


@pytest.mark.parametrize("transport", ["unicast", "zenoh"])
def test_robots_need_zenoh_only_when_it_is_chosen(transport: str) -> None:
    found = bundles(f"\nnetwork: {{transport: {transport}}}\n")
    for name in ("alice", "bert"):
        assert (b"eclipse-zenoh>=" in found[name]["requirements.txt"]) == (transport == "zenoh")
    assert b"zenoh" not in found["sim"]["requirements.txt"], "the simulator puts all on the loopback"


def test_every_robot_is_told_the_network() -> None:
    found = bundles("\nnetwork: {transport: multicast, group: 239.255.71.1}\n")
    for name in ("alice", "bert"):
        assert json.loads(found[name]["settings.json"])["network"] == {
            "transport": "multicast",
            "group": "239.255.71.1",
        }
