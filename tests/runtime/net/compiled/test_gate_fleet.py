"""Whole fleets with the gate and without: the same rounds, stores, traces and lines, from the same seed."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import Any

import pytest

from benchmarks.fixtures.fleet import Fleet
from benchmarks.fixtures.lineform import PROGRAM
from koordgen.runtime.net import gate
from koordgen.runtime.net.gate import Gate
from koordgen.runtime.net.network import Conditions
from koordgen.runtime.program.program import Program
from tests.runtime.net.compiled.gates import needs_gate
from tests.runtime.replication.test_transactions import COUNTER

pytestmark = needs_gate
CALM = Conditions(delay=0.001, jitter=0.004)
ROUGH = Conditions(loss=0.25, duplication=0.2, reordering=0.2, delay=0.001, jitter=0.03)
Story = Callable[[Fleet], None]


def told(fleet: Fleet) -> dict[int, Any]:
    """All that the robots did and said, and all that they counted."""
    found: dict[int, Any] = {}
    for pid, robot in fleet.robots.items():
        agent, replica = robot.agent, robot.agent._replica
        memory = None if replica is None else replica.memory
        if memory is not None:
            memory.advance(0)  # what the gate was told is settled, the memory finds when it goes on
        store = None if memory is None else (memory.applied, memory.shared, memory.held, memory.settled(), memory.acted)
        link, sessions = agent._link, agent._link.sessions
        columns = {name: c.tobytes() for name, c in {**sessions.columns(), **agent.metrics.columns()}.items()}
        found[pid] = {
            "trace": [json.loads(line) for line in robot.file.getvalue().splitlines()],
            "lines": robot.lines,
            "records": [re.sub(" at 0x[0-9a-f]+", "", str(record)) for record in robot.records],
            "commands": robot.platform.commands,
            "store": store,
            "round": (agent.round, agent.phase, agent.counters()),
            "link": (link.rejected, sessions.boots, sessions.due, columns),
            "kept": str(fleet.kept[pid].load()),
            "sent": fleet.network.sent,
        }
    return found


def runs(monkeypatch: pytest.MonkeyPatch, story: Story, **given: Any) -> None:
    """Both, and that the gate was in use in one of them."""
    taken = [0]
    take = Gate.take

    def counted(self: Gate, *arguments: Any) -> Any:
        taken[0] += 1
        return take(self, *arguments)

    monkeypatch.setattr(Gate, "take", counted)
    found = []
    for native in (True, False):
        with monkeypatch.context() as changed:
            if not native:
                changed.setattr(gate.COMPILED, "found", "not wanted")
            fleet = Fleet(**given).boot_all()
            story(fleet)
            found.append(told(fleet))
        assert taken[0] > 100
        usual = taken[0]
    assert taken[0] == usual
    for pid, robot in found[0].items():
        for name, value in robot.items():
            assert value == found[1][pid][name], (pid, name)


def runs_on(fleet: Fleet) -> None:
    fleet.run_rounds(60)
    fleet.run(1.0)


def restarts(fleet: Fleet) -> None:
    """Robots die, come back, are left out and let in again, and one is cut off."""
    fleet.run_rounds(15)
    for pid in (1, 0, 4, 1):
        robot = fleet.robots.pop(pid)
        fleet.run(0.3 if pid else 2.0)
        fleet.boot(pid, robot.platform)
        fleet.run(4.0)
    fleet.network.cut = lambda sender, receiver: 3 in (sender, receiver)
    fleet.run(3.0)
    fleet.network.cut = lambda sender, receiver: False
    fleet.run(4.0)


def hiccups(fleet: Fleet) -> None:
    """Robots sleep, so that much arrives at once."""
    fleet.run_rounds(10)
    for turn in range(8):
        robot = fleet.robots[turn % fleet.n]
        robot.wake = fleet.time.time + 0.4
        queue = fleet.network._queues[turn % fleet.n]
        late = [(max(at, robot.wake), number, datagram) for at, number, datagram in queue]
        queue[:] = sorted(late)
        fleet.network.links = {(p, turn % fleet.n): Conditions(delay=0.25) for p in range(fleet.n)}
        fleet.run(0.5)
        fleet.network.links = {}
        fleet.run(0.5)


@pytest.mark.parametrize("story", [runs_on, restarts, hiccups])
@pytest.mark.parametrize("program", [PROGRAM, COUNTER], ids=["plain", "transactions"])
@pytest.mark.parametrize("conditions", [CALM, ROUGH], ids=["calm", "rough"])
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_fleets_do_the_same(
    monkeypatch: pytest.MonkeyPatch, story: Story, program: Program, conditions: Conditions, seed: int
) -> None:
    runs(monkeypatch, story, n=5, seed=seed, program=program, conditions=conditions)


def test_a_larger_fleet_without_a_key(monkeypatch: pytest.MonkeyPatch) -> None:
    runs(monkeypatch, runs_on, n=16, seed=3, key=None, conditions=Conditions(loss=0.1, delay=0.001, jitter=0.03))
