"""Replay of traces of several applications: agents' traces agree with the programs, and changed values are reported."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import pytest

from benchmarks.fixtures.fleet import NAMES
from koordgen.build.emit.system import with_sizes
from koordgen.lang.semantics.composition import Application, System
from koordgen.runtime.net.network import Conditions
from koordgen.runtime.trace.schema import FORMAT, Header, RobotName
from koordgen.verify.replay.fleet import replay_trace
from koordgen.verify.replay.robot import Counts, Difference, Unreplayable
from koordgen.verify.replay.trace import open_trace
from tests.composed.agents import QUIET, ComposedAgents
from tests.composed.test_agent import Body
from tests.composed.test_agreement import ROUGH, contending
from tests.lang.semantics.compositions import compiled, random_system
from tests.verify.replay.runs import save_traces

ROUNDS = 20
Record = dict[str, Any]


def flown(folder: Path, system: System, seed: int = 1, conditions: Conditions = QUIET, kills: bool = False) -> Path:
    """Run agents, one of which dies and starts again if `kills`, and return the run's merged trace."""
    agents, rng = ComposedAgents(system, seed, conditions), Random(seed)
    if kills:
        robot = rng.randrange(system.robots)
        agents.fleet.run_rounds(rng.randrange(3, 8))
        agents.fleet.run(rng.random() * agents.fleet.delta)
        agents.kill(robot)
        agents.fleet.run(rng.choice([0.05, 0.5, 2.5]))
        agents.boot(robot)
    agents.run(ROUNDS + 25 * kills)
    robots = tuple([RobotName(NAMES[robot], robot, "fake") for robot in range(system.robots)])
    names = tuple([application.name for application in system.applications])
    header = Header(FORMAT, "+".join(names), "0" * 16, agents.fleet.delta, 0, robots, applications=names)
    save_traces(folder, header, agents.files, agents.fleet.time.time)
    return folder / "trace.jsonl"


def replayed(system: System, trace: Path) -> tuple[list[Difference], Counts]:
    """Return the differences between a trace and a system whose programs have no extern functions."""
    counts = Counts()
    return list(replay_trace(with_sizes(system), [{}] * len(system.applications), open_trace(trace), counts)), counts


def agrees(folder: Path, system: System, seed: int, conditions: Conditions = QUIET, kills: bool = False) -> Counts:
    trace = flown(folder, system, seed, conditions, kills)
    found, counts = replayed(system, trace)
    assert found == []
    for path in (folder / "robots").glob("*/trace.jsonl"):
        assert replayed(system, path)[0] == [], path
    return counts


@pytest.mark.parametrize("seed", range(8))
def test_traces_of_random_compositions_have_no_differences(tmp_path: Path, seed: int) -> None:
    assert agrees(tmp_path, random_system(seed), seed).rounds >= ROUNDS


def test_lost_datagrams_make_no_differences(tmp_path: Path) -> None:
    agrees(tmp_path, random_system(1), 1, ROUGH)


@pytest.mark.parametrize("seed", [0, 1])
def test_a_robot_that_dies_and_rejoins_makes_no_differences(tmp_path: Path, seed: int) -> None:
    agrees(tmp_path, random_system(seed), seed, kills=True)


@pytest.mark.slow
@pytest.mark.parametrize("first", range(4, 104, 20))
def test_traces_of_100_random_compositions_have_no_differences(tmp_path: Path, first: int) -> None:
    for seed in range(first, first + 20):
        kills = seed % 3 == 0
        agrees(tmp_path / str(seed), random_system(seed), seed, QUIET if kills else (QUIET, ROUGH)[seed % 2], kills)


def test_transactions_of_several_applications_that_lose_their_lock_make_no_differences(tmp_path: Path) -> None:
    assert agrees(tmp_path, contending(), 1).events >= ROUNDS - 2


OWNER = """\
export:
  write int n
  int x[N_SYS]
using Arm:
  sensors: int load
  actuators: int grip
local: int k
allwrite: int n
allread: int x[N_SYS]
Add:
  pre: True
  eff:
    n = k
    x[pid] = k
    k += 1
    Arm.grip = k
"""
READER = """\
import Owner:
  write int n
  int x[Owner.N_SYS]
local:
  int k
  int seen
Look:
  pre: n >= 0
  eff:
    seen = n + sum(x) + 10 * Owner.N_SYS + Owner.pid
    k += 1
"""


def tampered(trace: Path, change: Callable[[Record], bool]) -> int:
    """Change the first record of round 8 that `change` accepts, and return its line."""
    lines = trace.read_text().splitlines()
    for number, line in enumerate(lines):
        record = json.loads(line)
        if record["kind"] == "round" and record["round"] == 8 and change(record):
            lines[number] = json.dumps(record)
            trace.write_text("\n".join(lines) + "\n")
            return number + 1
    raise AssertionError("no record has such a value")


def replaces(application: str, group: str, name: str, value: Any) -> Callable[[Record], bool]:
    """Return a change of a value in the records of an application."""

    def change(record: Record) -> bool:
        if record["application"] != application or name not in record.get(group, {}):
            return False
        record[group][name] = value
        return True

    return change


def renames(record: Record) -> bool:
    found = bool(record["application"] == "reader" and record["event"] == "Look")
    record["event"] = "Other" if found else record["event"]
    return found


def stops(record: Record) -> bool:
    record["stopped"] = record["application"] == "reader"
    return bool(record["stopped"])


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> tuple[System, bytes]:
    """Two applications on different robots, one of which reads and imports, and their trace."""
    owner, reader = compiled("owner", OWNER), compiled("reader", READER)
    system = System(
        (Application("owner", owner, (0, 2)), Application("reader", reader, (1, 2), (("Owner", "owner"),))), 3
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tests.composed.agents.FakePlatform", Body)
        trace = flown(tmp_path_factory.mktemp("pair"), system)
    return system, trace.read_bytes()


@pytest.mark.parametrize(
    ("change", "application", "what"),
    [
        (renames, "reader", "the event"),
        (replaces("reader", "locals", "seen", 77), "reader", "seen"),
        (replaces("owner", "shared", "x", 77), "owner", "x"),
        (replaces("owner", "shared", "n", 77), "owner", "n"),
        (replaces("owner", "actuators", "Arm.grip", 77), "owner", "Arm.grip"),
        (replaces("reader", "copy", "n", 77), "reader", "copy of n"),
        (replaces("reader", "copy", "x", [77, 77]), "reader", "copy of x"),
        (stops, "reader", "stop"),
    ],
)
def test_a_changed_value_is_reported_with_its_application(
    tmp_path: Path, pair: tuple[System, bytes], change: Callable[[Record], bool], application: str, what: str
) -> None:
    system, trace = pair[0], tmp_path / "trace.jsonl"
    trace.write_bytes(pair[1])
    assert replayed(system, trace)[0] == []
    line = tampered(trace, change)
    found, _ = replayed(system, trace)
    first = [(d.application, d.round, d.what) for d in found if d.number == line]
    assert (application, 8, what) in first, found


def test_a_record_of_an_application_that_the_robot_does_not_run_is_refused(
    tmp_path: Path, pair: tuple[System, bytes]
) -> None:
    trace = tmp_path / "trace.jsonl"
    trace.write_bytes(pair[1])

    def moves(record: Record) -> bool:
        record["application"] = "reader" if record["pid"] == 0 else record["application"]
        return bool(record["pid"] == 0)

    tampered(trace, moves)
    with pytest.raises(Unreplayable, match="alice runs no application 'reader'"):
        replayed(pair[0], trace)
