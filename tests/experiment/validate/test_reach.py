"""Probes; reachsets as JSON, sizes and pictures; and one whole reachset of simple robots."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from koordgen.build.pipeline import check_file
from koordgen.experiment.campaign.executor import LocalPool
from koordgen.experiment.validate import draw, probe, reach, tube
from koordgen.experiment.validate.probe import BadProbe, Probe, Samples, Start
from koordgen.fleet import manifest

FLEET = """
delta: 0.1
origin: {latitude: 47.4, longitude: 8.5, altitude: 488.0}
geofence: {lo: [-9, -9, -0.5], hi: [9, 9, 4]}
params: {of_the_program: 3}
safety: {position_lost: 3.0}
obstacles: [{lo: [1, 1, 0], hi: [2, 2, 1]}]
world: {floor_friction: 0.8, markers: [{name: dock, position: [1, 1, 0]}]}
robots:
  - {name: ann, target: quad, address: "127.0.0.1:47100", settings: {max_speed: 1.5}, start: {position: [-3, 0, 0]}}
  - {name: bob, target: quad, address: "127.0.0.1:47101", settings: {max_speed: 1.5}, start: {position: [3, 0, 0]}}
  - {name: cem, target: quad, address: "127.0.0.1:47102", sim: {fidelity: simple}, start: {position: [5, 0, 0]}}
  - {name: dan, target: car, address: "127.0.0.1:47103", start: {position: [0, 5, 0]}}
  - {name: eve, target: car, address: "127.0.0.1:47104", settings: {max_speed: 2.0}, start: {position: [0, 7, 0]}}
sim: {position_noise: 0.01, min_separation: 0.5, boot: 0.5}
"""


@pytest.fixture
def platforms(tmp_path: Path) -> dict[str, probe.ProbedPlatform]:
    file = tmp_path / "fleet.yaml"
    file.write_text(FLEET)
    return probe.platforms(str(file))


def test_platforms_are_what_differs(platforms: dict[str, probe.ProbedPlatform]) -> None:
    assert list(platforms) == ["quad full", "quad simple", "car full (dan)", "car full (eve)"]
    assert platforms["quad full"].robot["settings"] == {"max_speed": 1.5}
    assert platforms["quad simple"].fidelity == "simple" and platforms["quad simple"].delta == 0.1


def test_a_probes_fleet_is_the_users_but_for_what_is_drawn(platforms: dict[str, probe.ProbedPlatform]) -> None:
    asked = Probe(platforms["quad full"], (1.0, 2.0, 0.0), count=20, seconds=5.0, robots=16, seed=3)
    fleet = probe.fleet_of(asked, 0)
    assert fleet == probe.fleet_of(asked, 0) != probe.fleet_of(asked, 1) != probe.fleet_of(replace(asked, seed=4), 1)
    assert len(fleet["robots"]) == 16 and len(probe.fleet_of(asked, 1)["robots"]) == 4 and asked.parts == 2
    assert fleet["delta"] == 0.1 and fleet["safety"] == {"position_lost": 3.0} and "obstacles" not in fleet
    assert fleet["world"] == {"floor_friction": 0.8}
    assert fleet["sim"]["position_noise"] == 0.01 and fleet["sim"]["min_separation"] == 0
    assert all(robot["settings"] == {"max_speed": 1.5} for robot in fleet["robots"])
    places = [robot["start"]["position"] for robot in fleet["robots"]]
    assert min(math.dist(a, b) for k, a in enumerate(places) for b in places[:k]) > 2 * (4.0 + math.hypot(1, 2))
    for shift, robot in zip(fleet["params"]["shift"], fleet["robots"], strict=True):
        assert math.dist(shift, (1.0, 2.0, 0.0)) <= 0.1
        assert abs(robot["start"]["yaw"] - math.atan2(2, 1)) <= 0.1
    assert all(5 <= last <= 25 for last in fleet["params"]["last"])


@pytest.mark.parametrize("target", ["quad", "car"])
def test_the_program_is_a_good_one(tmp_path: Path, target: str) -> None:
    (tmp_path / "probe.koord").write_text(probe.program_of(manifest.load(target)))
    assert check_file(str(tmp_path / "probe.koord")).diagnostics == ()


@pytest.mark.parametrize(
    ("changed", "said"),
    [({"offset": (0.0, 0.0, 2.0)}, "is zero in x and y"), ({"robots": 0}, "1 to 100"), ({"robots": 101}, "1 to 100")],
)
def test_what_cannot_be_probed_is_told(platforms: dict[str, probe.ProbedPlatform], changed: dict, said: str) -> None:  # type: ignore[type-arg]
    asked = Probe(platforms["quad full"], (1.0, 0.0, 0.0), count=20, seconds=5.0)
    with pytest.raises(BadProbe, match=said):
        probe.check(replace(asked, **changed))


def test_probes_are_of_all_platforms_or_of_those_that_are_named(tmp_path: Path) -> None:
    file = tmp_path / "fleet.yaml"
    file.write_text(FLEET)
    asked = reach.ReachsetRequest((3.0, 4.0, 0.0), epsilon=0.1, gamma=0.05, seed=7)
    assert [p.platform.name for p in reach.probes(str(file), [], asked)] == list(probe.platforms(str(file)))
    (one,) = reach.probes(str(file), ["quad simple"], asked)
    assert (one.count, one.seconds, one.seed, one.parts) == (90, 14.0, 7, 6)
    with pytest.raises(BadProbe, match="no platform 'boat'") as raised:
        reach.probes(str(file), ["boat"], asked)
    assert "quad simple" in raised.value.help


def test_an_external_autopilot_is_told(platforms: dict[str, probe.ProbedPlatform]) -> None:
    own = replace(platforms["quad full"], robot={"sim": {"autopilot": "external"}, "target": "quad"})
    with pytest.raises(BadProbe, match="real time only"):
        probe.check(Probe(own, (1.0, 0.0, 0.0), count=20, seconds=5.0))


def samples(platform: probe.ProbedPlatform, overshoot: float, offset: probe.Vector = (1.0, 0.0, 0.0)) -> Samples:
    """Of robots that go straight to their target and so far beyond it."""
    asked = Probe(platform, offset, 90, 5.0)
    random = np.random.default_rng(5)
    times = np.arange(5 * 240 + 1) / 240
    places = np.zeros((90, 3))
    places[:, :2] = random.uniform(-0.1, 0.1, (90, 2))
    share = 1 - np.exp(-2 * times) + overshoot * np.exp(-((times - 2.0) ** 2) * 8)
    paths = places[:, None] + (np.array(offset) - places)[:, None] * share[None, :, None]
    starts = np.hstack([places, np.zeros((90, 4))])
    return Samples(asked, times, paths, starts)


@pytest.fixture
def reached(platforms: dict[str, probe.ProbedPlatform]) -> list[tube.Reachset]:
    flying, driving = platforms["quad full"], platforms["car full (dan)"]
    return [tube.reachset_of(samples(flying, 0.3), 0.1, 0.05), tube.reachset_of(samples(driving, 0.0), 0.1, 0.05)]


def test_the_one_that_overshoots_has_the_larger_reachset(reached: list[tube.Reachset]) -> None:
    found = tube.compare(*reached)
    flying, driving = found.figures
    assert reached[0].observed.overshoot == pytest.approx(0.3 - math.exp(-4), abs=0.05)
    assert flying.overshoot >= reached[0].observed.overshoot > 0.2 > driving.overshoot
    assert flying.area > driving.area and flying.area > flying.area_delta
    assert flying.lateral >= reached[0].observed.lateral
    assert "quad full" in found.text() and json.loads(json.dumps(found.json()))["offset"] == [1, 0, 0]


def test_other_offsets_are_not_compared(reached: list[tube.Reachset]) -> None:
    with pytest.raises(ValueError, match="the offsets differ"):
        tube.compare(reached[0], replace(reached[1], offset=(2.0, 0.0, 0.0)))


def test_a_reachset_goes_through_json(reached: list[tube.Reachset]) -> None:
    told = json.loads(json.dumps(reached[0].json(), allow_nan=False))
    back = tube.from_json(told)
    again = back.json()
    assert {**again, "sensitivity": {**again["sensitivity"], "rates": told["sensitivity"]["rates"]}} == {
        **told, "offset": (1.0, 0.0, 0.0), "start": {**told["start"], "after": (0.5, 2.5)}, "samples": (30, 30, 30)
    }  # fmt: skip
    assert np.abs(back.lower - reached[0].lower).max() < 1e-4 and back.start == reached[0].start
    assert back.overshoot == pytest.approx(reached[0].overshoot, abs=1e-3)


@pytest.mark.parametrize("broken", [{"format": "koord-reachset/9"}, {"lower": None}, {"offset": 3}, {"start": {}}])
def test_what_is_no_reachset_is_told(reached: list[tube.Reachset], broken: dict) -> None:  # type: ignore[type-arg]
    with pytest.raises(ValueError):
        tube.from_json({**reached[0].json(), **broken})
    with pytest.raises(ValueError):
        tube.from_json({})


def test_the_measure_of_a_union() -> None:
    lower, upper = np.array([[0.0, 0, 0], [1, 1, 0], [5, 5, 5]]), np.array([[2.0, 2, 1], [3, 3, 1], [5.5, 6, 7]])
    assert tube.union(lower[:, :2], upper[:, :2]) == pytest.approx(4 + 4 - 1 + 0.5)
    assert tube.union(lower, upper) == pytest.approx(7 + 1)


def test_files_and_a_picture_are_written(reached: list[tube.Reachset], tmp_path: Path) -> None:
    files = reach.write_files(reached, tmp_path)
    assert [file.name for file in files] == ["quad-full.json", "car-full-dan.json", "reachsets.txt", "reachsets.png"]
    assert tube.from_json(json.loads(files[1].read_text())).platform == "car full (dan)"
    assert files[3].read_bytes().startswith(b"\x89PNG")
    with pytest.raises(ValueError, match="no reachset"):
        draw.draw_reachsets([], tmp_path / "none.png")


def test_simple_robots_are_probed(platforms: dict[str, probe.ProbedPlatform], tmp_path: Path) -> None:
    asked = Probe(platforms["quad simple"], (0.5, 0.5, 0.0), 3, 3.0, Start(after=(1.0, 1.5)), robots=3)
    (found,) = probe.collect_samples([asked], LocalPool(1), tmp_path / "out")
    assert found.positions.shape == (3, 721, 3) and found.times[-1] == 3.0
    # As the robot sensed it, with a centimetre of noise and what it moves in a twentieth of a second.
    assert (np.linalg.norm(found.starts[:, :2], axis=1) < 0.1 + 0.1).all()
    assert (found.starts[:, 3:5].min(axis=1) > 0.1).all(), "they fly"
    assert np.abs(found.positions[:, -1] - np.array([0.5, 0.5, 0.0])).max() < 0.15
    steps = np.linalg.norm(np.diff(found.positions, axis=1), axis=2)
    assert steps.max() < 1.6 / 240 * 1.1, "every step of the world"
    assert not list((tmp_path / "out").rglob("trace.jsonl")), "they are large"


@pytest.mark.slow
def test_the_quads_reachset_is_the_larger_one_because_it_overshoots(tmp_path: Path) -> None:
    """The published picture, with the very bundles, and the figures of docs/reference/validate.md: asked for as its
    command does, 24 runs of up to 16 robots. Where they have changed, the page and docs/pictures/reachsets.png take
    those of the command."""
    root = Path(__file__).parents[3]
    fleet = str(root / "examples" / "lineform" / "fleet.yaml")
    flying, driving = reach.reachsets(
        fleet, (), reach.ReachsetRequest((0.7, 0.4, 0.0), seed=1), LocalPool(2), tmp_path / "out"
    )
    names = [file.name for file in reach.write_files([flying, driving], tmp_path / "left")]
    assert names == ["quad-full.json", "car-full.json", "reachsets.txt", "reachsets.png"]
    found = tube.compare(flying, driving)
    assert flying.covered >= 0.95 and driving.covered >= 0.95
    assert flying.observed.overshoot > 0.03 > driving.observed.overshoot
    assert flying.overshoot > driving.overshoot + 0.03
    assert found.figures[0].area > found.figures[1].area
    page = (root / "docs/reference/validate.md").read_text(encoding="utf-8")
    assert found.text() in page, f"docs/reference/validate.md is out of date:\n{found.text()}"


def test_a_run_that_fails_is_told(platforms: dict[str, probe.ProbedPlatform], tmp_path: Path) -> None:
    own = replace(platforms["quad simple"], common={**platforms["quad simple"].common, "sim": {"start_timeout": 1.0}})
    with pytest.raises(BadProbe, match="of a probe failed"):
        probe.collect_samples([Probe(own, (1.0, 0.0, 0.0), 1, 1.0, robots=1)], LocalPool(1), tmp_path / "out")


def test_a_probes_fleet_is_yaml(platforms: dict[str, probe.ProbedPlatform]) -> None:
    fleet = probe.fleet_of(Probe(platforms["car full (eve)"], (1.0, 0.0, 0.0), 2, 1.0), 0)
    assert yaml.safe_load(yaml.safe_dump(fleet)) == fleet
