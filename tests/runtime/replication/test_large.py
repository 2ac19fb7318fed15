"""Values that are longer than a datagram: eight robots at maps of 160 x 140 cells, in fragments and in patches."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from random import Random
from typing import Any

import pytest
from msgspec import Raw

from benchmarks.fixtures.fleet import KEY, Fleet, Robot
from benchmarks.fixtures.lineform import PROGRAM
from koordgen.runtime.config.settings import Safety
from koordgen.runtime.net import codec
from koordgen.runtime.net.network import Conditions
from koordgen.runtime.net.sender import MessageSender
from koordgen.runtime.net.wire import LIMIT, Entry, RoundMessage, Write
from koordgen.runtime.program.program import Event, Frame, Transaction, Variable
from koordgen.runtime.values.bounds import Cells
from koordgen.runtime.values.gridmap import OCCUPIED, GridMap, area, is_occupied, mark_occupied
from koordgen.runtime.values.points import Grid, Point
from tests.runtime.replication.agents import locals_of, rounds_of, snapshot_of

WIDTH, HEIGHT, N = 160, 140, 8
MARKS = 4  # cells that each robot marks in the map of all


def blank() -> GridMap:
    return area(Point(), Point(WIDTH, HEIGHT), 1.0)


def dense(seed: int) -> GridMap:
    """Nothing that could be shortened."""
    rng = Random(seed)
    codes = [rng.choice((0, 1, OCCUPIED)) for _ in range(WIDTH * HEIGHT)]
    cells = bytes(a | b << 2 | c << 4 | d << 6 for a, b, c, d in zip(*[iter(codes)] * 4, strict=True))
    return replace_cells(blank(), cells)


def replace_cells(m: GridMap, cells: bytes) -> GridMap:
    return GridMap(m.resolution, m.x, m.y, m.width, m.height, cells)


DENSE = [dense(seed) for seed in range(N)]


class State(Transaction):
    def __init__(self, frame: Frame) -> None:
        super().__init__(frame)
        self.mine: Any = self.slots("mine")
        self.chart: Any = self.shared("chart")
        self.count: Any = self.local("count")


def begins(s: State) -> None:
    s.mine.own = DENSE[s.pid]
    s.count.value = 1


def charts(s: State) -> None:
    s.chart.value = mark_occupied(s.chart.value, Grid(s.count.value, s.pid, 1.0))
    s.count.value += 1


def edits(s: State) -> None:
    k = s.count.value = s.count.value + 1
    s.mine.own = mark_occupied(s.mine.own, Grid(k % WIDTH, k * 7 % HEIGHT, 1.0))


MAPS = replace(
    PROGRAM,
    init=None,
    begin=State,
    shared=(
        Variable("mine", "allread", GridMap, Cells(WIDTH * HEIGHT), blank),
        Variable("chart", "allwrite", GridMap, Cells(WIDTH * HEIGHT), blank),
    ),
    events=(
        Event("Begin", 3, lambda s: s.count.value == 0, begins),
        Event("Chart", 5, lambda s: s.count.value <= MARKS, charts, 0),
        Event("Edit", 7, lambda s: s.count.value < 2 * MARKS, edits),
    ),
    locks=(("chart",),),
)


def store(robot: Robot) -> Any:
    state = snapshot_of(robot)
    assert state is not None
    return state.shared


def finish(fleet: Fleet) -> None:
    """Until all have edited as often as they shall, and everyone has heard of it."""
    fleet.run(60, until=lambda: all(locals_of(r)["count"] == 2 * MARKS for r in fleet.robots.values()))
    fleet.run(1.5)
    first = store(fleet.robots[0])
    chart, mine = blank(), []
    for pid in range(N):
        own = DENSE[pid]
        for k in range(1, MARKS + 1):
            chart = mark_occupied(chart, Grid(k, pid, 1.0))
        for k in range(MARKS + 2, 2 * MARKS + 1):
            own = mark_occupied(own, Grid(k % WIDTH, k * 7 % HEIGHT, 1.0))
        mine.append(own)
    assert first["chart"] == chart and first["mine"] == tuple(mine)
    assert is_occupied(chart, Grid(1, 7, 1.0)), "the test's own map is no blank one"
    for robot in fleet.robots.values():
        assert store(robot) == first
        state = snapshot_of(robot)
        assert state is not None and state.unfit == 0
        assert not any("does not fit" in reason for reason in robot.agent._link.rejected), robot.agent._link.rejected


@pytest.mark.parametrize("length", [1, 30, 300, 700, 5000])
def test_a_report_with_entries_goes_in_as_few_datagrams_as_it_fits_in(length: int) -> None:
    """Where all fit into one they need no other way than those that do not; no echo is lost on the way."""
    fleet = Fleet(n=3).boot_all()
    fleet.run_rounds(3)
    speech, sent = fleet.robots[0].agent._link.sender, list[bytes]()
    assert isinstance(speech, MessageSender)
    fleet.network.send = lambda sender, receiver, datagram: sent.append(datagram)  # type: ignore[method-assign]
    value = Raw(codec.encoder.encode("x" * length))
    entries = [Entry(0, 0, r, r, acted=True, writes=(Write(0, value),)) for r in range(1, 5)]
    speech._next_echo = float("-inf")
    speech._echoed.clear()
    speech.round([1], (0, 5, 4, 3, False, (), tuple(entries)))
    messages = [codec.decode(d, KEY) for d in sent]
    rounds = [m for m in messages if isinstance(m, RoundMessage)]
    assert all(len(d) <= LIMIT for d in sent) and len(messages) == {1: 1, 30: 1, 300: 2, 700: 4, 5000: 25}[length]
    assert [c for m in rounds for c in m.entries] == (entries if length < LIMIT else [])
    assert sum(len(m.head.echoes) for m in messages if not isinstance(m, str)) == 1
    assert len({m.head.sequence for m in messages if not isinstance(m, str)}) == len(messages)


def tapped(fleet: Fleet) -> Counter[str]:
    """Counts the datagrams by their kinds, and the bytes of them all."""
    sent: Counter[str] = Counter()
    send = fleet.network.send

    def tap(sender: int, receiver: int, datagram: bytes) -> None:
        sent[type(codec.decode(datagram, KEY)).__name__] += 1
        sent["bytes"] += len(datagram)
        send(sender, receiver, datagram)

    fleet.network.send = tap  # type: ignore[method-assign]
    return sent


def test_a_dense_map_goes_in_fragments_once_and_what_changes_of_it_in_patches() -> None:
    fleet = Fleet(n=N, program=MAPS).boot_all()
    fleet.run(60, until=lambda: all(rounds_of(r) is not None for r in fleet.robots.values()))
    sent = tapped(fleet)
    finish(fleet)
    room = fleet.robots[0].agent._link.sender.room
    fragments = -(-(WIDTH * HEIGHT // 4) // room)
    assert fragments * N * (N - 1) <= sent["Fragment"] <= (fragments + 1) * N * (N - 1)
    patched = sent["bytes"] - sent["Fragment"] * 1200
    datagrams = sum(sent[kind] for kind in ("RoundMessage", "Nack", "Hello"))
    assert patched < 400 * datagrams, "what changes little goes as a patch"


@pytest.mark.parametrize("seed", range(2))
def test_maps_come_whole_through_a_network_that_loses_a_third(seed: int) -> None:
    conditions = Conditions(loss=0.3, delay=0.001, jitter=0.01, duplication=0.1)
    finish(Fleet(n=N, seed=seed, program=MAPS, conditions=conditions, delta=0.2).boot_all())


def test_a_robot_that_dies_gets_all_maps_again() -> None:
    conditions = Conditions(loss=0.1, delay=0.001, jitter=0.01)
    fleet = Fleet(n=N, program=MAPS, conditions=conditions, safety=Safety(peer_timeout=10)).boot_all()
    fleet.run_rounds(12)
    fleet.robots.pop(5)
    fleet.run(0.3)
    fleet.boot(5)
    finish(fleet)
