"""Who is not let into a mission, and what the others are told of it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from benchmarks.fixtures.fleet import Fleet
from benchmarks.fixtures.lineform import PROGRAM
from koordgen.runtime.agent.joining import PERIOD


def test_a_recorded_hello_of_an_earlier_boot_never_passes_for_live() -> None:
    fleet = Fleet(n=3)
    recorded: list[tuple[int, bytes]] = []
    send = fleet.network.send

    def tapped(sender: int, receiver: int, datagram: bytes) -> None:
        if sender == 1:
            recorded.append((receiver, datagram))
        send(sender, receiver, datagram)

    fleet.network.send = tapped  # type: ignore[method-assign]
    fleet.boot(0)
    fleet.boot(1)
    fleet.run(1.0)
    old = fleet.robots[0].agent._link.sessions[1].boot
    del fleet.robots[1]
    old_hellos = list(recorded)
    fleet.boot(1)
    fleet.run(1.0)
    new = fleet.robots[1].agent._link.boot
    assert fleet.robots[0].agent._link.sessions[1].boot == new != old
    for receiver, datagram in old_hellos:
        if receiver in fleet.network._queues:
            send(1, receiver, datagram)
    fleet.run(0.01)
    assert fleet.robots[0].agent._link.sessions[1].boot == new
    fleet.boot(2)
    for _ in range(5):
        for receiver, datagram in old_hellos:
            send(1, receiver, datagram)
        fleet.run(0.3)
    fleet.run_rounds(3)
    assert all(r.records[-1].frame is not None for r in fleet.robots.values())


def test_replayed_hellos_are_answered_once_a_period_and_keep_nobody_out() -> None:
    """Hellos of earlier boots of robot 1, thousands a second: robot 0 answers few, and lets robot 1 come back."""
    fleet = Fleet(n=3)
    recorded: dict[bytes, None] = {}
    answers = 0
    send = fleet.network.send

    def tapped(sender: int, receiver: int, datagram: bytes) -> None:
        nonlocal answers
        if (sender, receiver) == (1, 0) and fleet.robots[1].agent.phase == "joining":
            recorded[datagram] = None
        answers += (sender, receiver) == (0, 1)
        send(sender, receiver, datagram)

    fleet.network.send = tapped  # type: ignore[method-assign]
    fleet.boot(0)
    for _ in range(3):
        fleet.boot(1)
        fleet.run(0.5)
        del fleet.robots[1]
    fleet.boot(1)
    fleet.boot(2)
    fleet.run_rounds(3)
    old_hellos = list(recorded)
    del fleet.robots[1]
    fleet.run(2.0)
    answers = 0
    for _ in range(40):
        for datagram in old_hellos * 10:
            send(1, 0, datagram)
        fleet.run(0.05)
    flooded = answers
    answers = 0
    fleet.run(2.0)
    assert flooded - answers <= 2.0 / PERIOD + 2
    fleet.boot(1)
    for _ in range(100):
        for datagram in old_hellos:
            send(1, 0, datagram)
        fleet.run(0.05)
        if fleet.robots[1].agent.phase == "running":
            break
    assert fleet.robots[1].agent.phase == "running"


def test_a_robot_that_kept_nothing_of_the_mission_is_told_of_and_not_let_in() -> None:
    fleet = Fleet(n=3).boot_all()
    fleet.run_rounds(5)
    fleet.kept[1].clear()
    fleet.boot(1)
    fleet.run(2.0)
    assert fleet.robots[1].agent.phase == "joining"
    assert any("alice, cleo in a mission that began before this start" in line for line in fleet.robots[1].lines)
    told = [line for line in fleet.robots[0].lines if "bert restarted without state during the mission" in line]
    assert len(told) == 1
    assert not fleet.robots[0].platform.held, "the others go on without it"


def test_a_robot_with_another_program_is_named() -> None:
    fleet = Fleet(n=3)
    fleet.boot(0)
    fleet.boot(2)
    fleet.boot(1, program=replace(PROGRAM, program_hash="ffffffffffffffff"))
    fleet.run(3.0)
    assert all(r.agent.round == 0 for r in fleet.robots.values())
    for pid in (0, 2):
        said = [line for line in fleet.robots[pid].lines if "robot bert runs another program" in line]
        assert len(said) == 1


def test_a_robot_with_another_release_is_named_and_the_mission_does_not_begin() -> None:
    fleet = Fleet(n=3)
    fleet.boot(0, release="a" * 32)
    fleet.boot(2, release="a" * 32)
    fleet.boot(1, release="b" * 32)
    fleet.run(3.0)
    assert all(r.agent.round == 0 for r in fleet.robots.values())
    for pid in (0, 2):
        said = [line for line in fleet.robots[pid].lines if f"robot bert runs another release ({'b' * 32}, " in line]
        assert len(said) == 1


def test_a_robot_that_restarts_with_another_release_does_not_come_back() -> None:
    fleet = Fleet(n=3)
    for pid in range(3):
        fleet.boot(pid, release="a" * 32)
    fleet.run_rounds(5)
    fleet.boot(1, release="b" * 32)
    fleet.run(3.0)
    assert fleet.robots[1].agent.phase == "joining"
    assert any("robot bert runs another release" in line for line in fleet.robots[0].lines)
    fleet.boot(1, release="a" * 32)
    fleet.run_rounds(30)
    assert fleet.robots[1].agent.phase == "running"


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"release": "b" * 32}, "another release of this program"),
        ({"key": bytes(32)}, "sealed with another key"),
        ({"key": None, "insecure": True}, "sealed with another key"),
        ({"application_id": 7}, "another application_id"),
        ({"program": replace(PROGRAM, program_hash="ffffffffffffffff")}, "another program"),
    ],
)
def test_the_waiting_say_why_a_robot_that_sends_is_not_heard(change: dict[str, Any], told: str) -> None:
    fleet = Fleet(n=2)
    fleet.boot(0)
    fleet.boot(1, **change)
    fleet.run(3.0)
    for robot in fleet.robots.values():
        said = [line for line in robot.lines if "not heard yet" in line]
        assert told in said[-1]
        assert len(said) <= 3, "once in each phase, and once more when the reason is known"


def test_silence_is_given_no_reason() -> None:
    fleet = Fleet(n=2)
    fleet.boot(0)
    fleet.run(3.0)
    said = [line.rpartition(": ")[2] for line in fleet.robots[0].lines if "waiting" in line]
    assert said == ["warming up; waiting for bert, not heard yet", "waiting for bert, not heard yet"]
