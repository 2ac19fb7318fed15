"""Audits of the robots' own traces, compared with the simulator's verdicts on the true state."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from random import Random
from typing import Any

import pytest

from tests.sim.lockstep.lockstep import ran, summary
from tests.verify.audit.fleets import FORMULAS, LINE, audited, by_name, conditions, disagreements, saved, watched

DELTA = 0.1


def compared(folder: Path, seed: int, seen: Counter[str]) -> None:
    """One small fleet: some of the formulas, some loss, in some of them a robot that lands by itself."""
    rng = Random(seed)
    names = rng.sample(sorted(FORMULAS), 4)
    text = LINE + "".join(f"invariant {name}: {FORMULAS[name]}\n" for name in names)
    fleet = watched(folder, text, n=rng.choice((3, 3, 4)), seed=seed, conditions=conditions(rng.choice((0.0, 0.1))))
    fleet.run(rng.uniform(2.0, 3.5))
    if rng.random() < 0.3:
        fleet.fleet.robots[1].agent.end("landing")
        fleet.run(1.0)
    verdicts: dict[str, dict[str, Any]] = {n: {"outcome": v.outcome, "since": v.since} for n, v in fleet.end().items()}
    status, document = audited(saved(folder, fleet, text))
    properties = by_name(document)
    assert not disagreements(verdicts, properties, DELTA), (seed, document["notes"])
    told = {p["verdict"] for p in properties.values()}
    assert status == (3 if told & {"violated", "no value"} else 4 if "unknown" in told else 0)
    seen.update(v["outcome"] for v in verdicts.values())
    for name in names:  # what is neither ports nor moments is the same to the round
        verdict, first = verdicts[name], properties[name]["first"]
        if first is not None and "Motion" not in FORMULAS[name]:
            assert first["seconds"] == pytest.approx(max(0.0, verdict["since"]), abs=0.01), (seed, name)
            seen["same round"] += 1


def test_small_fleets_are_judged_as_the_simulator_judges_them(tmp_path: Path) -> None:
    seen: Counter[str] = Counter()
    for seed in range(7):
        compared(tmp_path / str(seed), seed, seen)
    assert seen["violated"] and seen["same round"] >= 2 and seen["held"] >= 15 and seen["out of model"], seen


@pytest.mark.slow
def test_300_small_fleets_are_judged_as_the_simulator_judges_them(tmp_path: Path) -> None:
    seen: Counter[str] = Counter()
    for seed in range(100, 400):
        compared(tmp_path / str(seed), seed, seen)
    print(dict(seen))


CHASE = """\
using Motion:
  sensors:
    Point position
    bool reached
  actuators: Point target
  assume position' in Rect(position, target) or position' in Ball(target, 20)
allread: Point x[N_SYS]
local: int moved
init: x[pid] = Motion.position
Go:
  pre: pid == 0 and N_SYS > 2 and moved < 12
  eff:
    Motion.target = x[2]
    x[pid] = Motion.position
    moved += 1
initially: forall i, j in ID: i == j or distance(Motion.position[i], Motion.position[j]) > 1
invariant Apart: forall i, j in ID: i == j or distance(Motion.position[i], Motion.position[j]) > 1
invariant Shared: forall i in ID: distance(x[i], Motion.position[i]) < 0.5
invariant Moved: forall i in ID: moved[i] <= 20
"""
MUTANTS = {
    "as it is": ("", ""),
    "an invariant of what robots have": ("moved[i] <= 20", "moved[i] <= 7"),
    "the beginning": ("> 1\ninvariant", "> 2\ninvariant"),
    "an assumption": ("in Rect(position, target) or position' in Ball(target, 20)", "in Ball(position, 0.02)"),
    "no value": ("moved[i] <= 20", "1 / (9 - moved[i]) < 9"),
}
FAULTS = """\
network: {loss: 0.1, delay: 0.01, jitter: 0.02}
events:
  - {at: 0.6, for: 0.7, partition: [[alice, bert, cleo, dora], [emil]]}
  - {at: 1.0, for: 0.6, freeze: dora}
"""
CRASH = """\
events:
  - {at: 1.2, crash: cleo}
"""


def chased(folder: Path, mutant: str) -> Path:
    from koordgen.cli import main
    from tests.sim.lockstep.lockstep import EXAMPLES

    source = folder / "chase.koord"
    source.write_text(CHASE.replace(*MUTANTS[mutant]) if mutant != "as it is" else CHASE)
    fleet = EXAMPLES / "atomicsum/fleet.yaml"
    assert main(["build", str(source), "--fleet", str(fleet), "--target", "sim", "-o", str(folder / "build")]) == 0
    return folder / "build/chase/sim"


@pytest.mark.slow
@pytest.mark.parametrize("mutant", MUTANTS)
@pytest.mark.parametrize("faults", ["", FAULTS, CRASH], ids=["none", "network", "crash"])
def test_runs_of_the_simulator_are_judged_as_it_judges_them(
    tmp_path: Path, mutant: str, faults: str, capsys: pytest.CaptureFixture[str]
) -> None:
    import yaml

    bundle, out = chased(tmp_path, mutant), tmp_path / "out"
    more = []
    if faults:
        (tmp_path / "faults.json").write_text(json.dumps(yaml.safe_load(faults)))
        more = ["--scenario", str(tmp_path / "faults.json")]
    ran(bundle, out, 3.0, *more)
    said = {p["name"] or p["of"]: p for p in summary(out)["properties"]}
    status, document = audited(out / "robots", "--program", tmp_path / "chase.koord")
    merged, whole = audited(out)
    mine = by_name(document)
    assert not disagreements(said, mine, 2 * DELTA), (document["notes"], mine)
    for own, other in zip(document["properties"], whole["properties"], strict=True):
        assert own == other, "the merged trace says the same"
    bad = {name for name, p in mine.items() if p["verdict"] in ("violated", "no value")}
    assert (status == 3) == bool(bad) and status == merged
    print({name: (p["verdict"], said.get(name, {}).get("outcome")) for name, p in mine.items()})
    if mutant != "as it is" or not faults:
        assert bad
