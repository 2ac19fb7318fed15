"""No robot begins to move before it has heard all of its fleet, running the same program."""

from __future__ import annotations

from dataclasses import replace

from benchmarks.fixtures.fleet import STARTS, FakePlatform, Fleet
from benchmarks.fixtures.lineform import PROGRAM


class Waiting(FakePlatform):
    """Becomes ready by moving: not while it is held."""

    moved: float | None = None

    def start(self, now: float) -> None:
        assert self.held, "from before its start"
        super().start(now)

    def poll(self, now: float) -> None:
        super().poll(now)
        if not self.held and self.moved is None:
            self.moved = now

    @property
    def ready(self) -> bool:
        return self.moved is not None and self.now - self.moved > 1.0


def waiting_fleet() -> Fleet:
    fleet = Fleet(n=3)
    fleet.boot(0, Waiting(STARTS[0]))
    fleet.boot(2, Waiting(STARTS[2]))
    return fleet


def moved(fleet: Fleet, pid: int) -> bool:
    platform = fleet.robots[pid].platform
    assert isinstance(platform, Waiting)
    return platform.moved is not None


def test_nobody_moves_before_all_were_heard() -> None:
    fleet = waiting_fleet()
    fleet.run(5.0)
    assert not moved(fleet, 0) and not moved(fleet, 2)
    assert any("warming up; waiting for bert, not heard yet" in line for line in fleet.robots[0].lines)
    fleet.boot(1, Waiting(STARTS[1]))
    fleet.run(1.0)
    assert all(moved(fleet, pid) for pid in range(3))
    fleet.run_rounds(3)
    assert not any(r.platform.held for r in fleet.robots.values())


def test_nobody_moves_with_one_that_runs_another_program() -> None:
    fleet = waiting_fleet()
    fleet.boot(1, Waiting(STARTS[1]), program=replace(PROGRAM, program_hash="ffffffffffffffff"))
    fleet.run(5.0)
    assert not any(moved(fleet, pid) for pid in range(3))
    for pid in (0, 2):
        assert any(
            "waiting for bert, not heard yet (a robot runs another program)" in s for s in fleet.robots[pid].lines
        )


def test_one_that_the_others_do_not_wait_for_does_not_move() -> None:
    fleet = waiting_fleet()
    fleet.boot(1, Waiting(STARTS[1]))
    fleet.run_rounds(5)
    fleet.kept[1].clear()
    fleet.boot(1, Waiting(STARTS[1]))
    fleet.run(3.0)
    assert not moved(fleet, 1) and any("in a mission that began before" in line for line in fleet.robots[1].lines)


def test_one_that_comes_back_moves_as_soon_as_it_has_heard_of_its_mission() -> None:
    fleet = waiting_fleet()
    fleet.boot(1, Waiting(STARTS[1]))
    fleet.run_rounds(5)
    del fleet.robots[2]  # never comes again
    fleet.boot(1, Waiting(STARTS[1]))
    fleet.run(3.0)
    assert moved(fleet, 1)
    fleet.run_rounds(fleet.robots[0].agent.round + 30)
    assert fleet.robots[1].agent.phase == "running" and not fleet.robots[1].platform.held
