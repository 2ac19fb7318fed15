"""Chaos with real processes and a real kernel between them. Each test is a command:
`pytest -m slow tests/chaos/test_real.py -k counter`."""

from __future__ import annotations

import random
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from tests.chaos.bundle import build
from tests.chaos.checks import commits, current, is_current, rounds, wrong_reads, wrong_sums
from tests.chaos.lab import Lab
from tests.chaos.runs import Say, scaled, side_by_side
from tests.chaos.swarm import Swarm

pytestmark = pytest.mark.slow
N = 5
TIMES = 8  # that each robot counts
LONG = 90.0  # seconds after which a counter hangs
PEER_TIMEOUT = 10  # rounds
HEALED = PEER_TIMEOUT + 20  # rounds after which a fleet has converged that was apart


@dataclass
class Ended:
    """How a run went: what was wrong, and what it took."""

    wrong: list[str] = field(default_factory=list)
    rounds: int = 0
    reads: int = 0
    kills: int = 0


def judge(ends: list[Ended], say: Say) -> None:
    wrong = [text for end in ends for text in end.wrong]
    say(f"{sum(bool(e.wrong) for e in ends)} of {len(ends)} runs wrong; rounds {sorted(e.rounds for e in ends)}")
    assert not wrong, "\n".join(wrong[:20])


@pytest.mark.parametrize("loss", [0.0, 0.1, 0.3, 0.5])
def test_counter(loss: float, tmp_path: Path, bundles: Path, say: Say) -> None:
    bundle = build("counter", bundles, times=TIMES)

    def counter(run: int) -> Ended:
        with Lab(N, loss) as lab, Swarm(lab, bundle, tmp_path / str(run)) as swarm:
            ended = swarm.start_all().wait(LONG)
            wrong = wrong_sums(swarm.lines, TIMES)
            if not ended:
                wrong.append(f"hangs in round {swarm.round()}")
            wrong += [f"robot {pid}: status {r.status}" for pid, r in swarm.robots.items() if r.status]
            return Ended([f"run {run}: {w}" for w in wrong], swarm.round())

    judge(side_by_side(counter, scaled(24), say, f"counter at {loss:.0%} loss"), say)


@pytest.mark.parametrize("delay", [0.0, 0.05])
def test_next_round(delay: float, tmp_path: Path, bundles: Path, say: Say, monkeypatch: pytest.MonkeyPatch) -> None:
    """Events of 0 to 500 ms, so that some come too late; 30 % loss; then also a relay that delays and reorders."""
    monkeypatch.setenv("KOORDGEN_CHAOS_PAUSE", "0.5")
    bundle, fleets = build("steps", bundles), 6
    wanted = scaled(5000)

    def steps(run: int) -> Ended:
        with Lab(N, 0.3) as lab, Swarm(lab, bundle, tmp_path / str(run), 0.8, delay) as swarm:

            def enough() -> bool:
                return wrong_reads(swarm.lines)[0] >= wanted / fleets

            ended = swarm.start_all().wait(60 + wanted / 10, enough)
            swarm.end()
            reads, wrong = wrong_reads(swarm.lines)
            if not ended or reads < wanted / fleets:
                wrong.append(f"only {reads} reads until round {swarm.round()}")
            return Ended([f"run {run}: {w}" for w in wrong], swarm.round(), reads)

    ends = side_by_side(steps, fleets, say, f"next round, delay up to {delay} s", fleets)
    say(f"{sum(e.reads for e in ends)} reads")
    judge(ends, say)


def test_kill_and_restart(tmp_path: Path, bundles: Path, say: Say) -> None:
    kills_a_run, times = 5, 40
    bundle = build("counter", bundles, times=times)

    def killed(run: int) -> Ended:
        chance = random.Random(run)
        with Lab(N, 0.05) as lab, Swarm(lab, bundle, tmp_path / str(run)) as swarm:
            swarm.start_all().wait(30, lambda: swarm.round() > 3)
            kills = 0
            for _ in range(kills_a_run):
                if swarm.wait(chance.uniform(0.2, 1.5)):
                    break
                swarm.wait(20, lambda: sum(not r.back for r in swarm.robots.values()) < 2)  # a majority stays
                # Nobody whom the others can finish without: they would be gone when it comes back.
                busy = [p for p in range(N) if len(commits(swarm.lines[p])) < times - 10]
                if not busy:
                    break
                pid = chance.choice(busy)
                swarm.kill(pid)
                kills += 1
                swarm.wait(chance.choice([0.0, 0.1, 1.5]))
                swarm.start(pid)
            ended = swarm.wait(LONG)
            wrong = wrong_sums(swarm.lines, times, complete=False)
            if not ended:
                wrong.append(f"hangs in round {swarm.round()}: {swarm.said()}")
            wrong += [f"robot {pid}: status {r.status}" for pid, r in swarm.robots.items() if r.status]
            return Ended([f"run {run}: {w}" for w in wrong], swarm.round(), kills=kills)

    ends = side_by_side(killed, scaled(10), say, "kill and restart")
    say(f"{sum(e.kills for e in ends)} kills")
    judge(ends, say)


def test_killed_for_good(tmp_path: Path, bundles: Path, say: Say) -> None:
    """The others run events again within peer_timeout + 5 rounds of the death."""
    bundle, runs, delta = build("steps", bundles), scaled(5), 0.1
    away: list[int] = []

    def killed(run: int) -> Ended:
        victim = run % N
        with Lab(N) as lab, Swarm(lab, bundle, tmp_path / str(run), delta) as swarm:
            swarm.start_all().wait(30, lambda: swarm.round() > 5)
            swarm.wait(random.Random(run).uniform(1, 2))
            swarm.kill(victim)
            died = time.monotonic()
            swarm.wait((PEER_TIMEOUT + 30) * delta)
            swarm.end()
            wrong = []
            for pid, lines in swarm.lines.items():
                ran = [t for t in rounds(lines) if t["event"]]
                at = next((t["round"] for t in rounds(lines) if t["time"] >= died), 0)
                after = [t["round"] - at for t in ran if t["round"] > at + 2]
                if pid != victim:
                    away.append(min(after, default=999))
                    if away[-1] > PEER_TIMEOUT + 5 or len(after) < 10:
                        wrong.append(f"robot {pid} runs again after {away[-1]} rounds, {len(after)} events")
            return Ended([f"run {run}: {w}" for w in wrong], swarm.round())

    ends = side_by_side(killed, runs, say, "killed for good")
    say(f"events again after {Counter(away)} rounds")
    judge(ends, say)


def test_partition_and_heal(tmp_path: Path, bundles: Path, say: Say) -> None:
    times, delta = 60, 0.05
    bundle, runs = build("counter", bundles, times=times), scaled(6)

    def parted(run: int) -> Ended:
        chance = random.Random(run)
        order = chance.sample(range(N), N)
        majority, minority = order[:3], order[3:]
        with Lab(N) as lab, Swarm(lab, bundle, tmp_path / str(run), delta) as swarm:
            swarm.start_all().wait(30, lambda: swarm.round() > 3)
            swarm.wait(chance.uniform(0.5, 1.5))
            lab.partition([majority, minority])
            cut = time.monotonic()
            swarm.wait(40 * delta)
            healed = time.monotonic()
            lab.heal()
            ended = swarm.wait(LONG)
            wrong = wrong_sums(swarm.lines, times)
            if not ended:
                wrong.append(f"hangs in round {swarm.round()}: {swarm.said()}")
            apart = [t for p in minority for t in commits(swarm.lines[p]) if cut + 2 * delta < t["time"] < healed]
            wrong += [f"the minority committed total {t['shared']['total']}" for t in apart]
            going = [t for p in majority for t in commits(swarm.lines[p]) if cut + 4 * delta < t["time"] < healed]
            if not going:
                wrong.append("the majority committed nothing while apart")
            for pid in range(N):
                # Not the first event: a robot that has counted to the end while they were apart has none to run.
                good = [t["time"] for t in rounds(swarm.lines[pid]) if t["time"] > healed and is_current(t)]
                if not good or min(good) > healed + HEALED * delta:
                    wrong.append(f"robot {pid} was not current within {HEALED} rounds of the heal")
            return Ended([f"run {run}: {w}" for w in wrong], swarm.round())

    judge(side_by_side(parted, runs, say, "partition"), say)


@pytest.mark.parametrize(("loss", "least"), [(0.0, 0.999), (0.3, 0.9)])
def test_availability(loss: float, least: float, tmp_path: Path, bundles: Path, say: Say) -> None:
    bundle, wanted, fleets, first = build("steps", bundles), scaled(500), 2, 10

    def share(run: int) -> tuple[float, Counter[str]]:
        with Lab(N, loss) as lab, Swarm(lab, bundle, tmp_path / str(run), 0.1) as swarm:
            swarm.start_all().wait(60 + wanted * 0.1, lambda: swarm.round() > wanted + first + 30)
            swarm.end()
            return current(swarm.lines, first, first + wanted)

    found = side_by_side(share, fleets, say, f"availability at {loss:.0%} loss", fleets)
    for part, why in found:
        say(f"{part:.3%} of robot-rounds current at {loss:.0%} loss; no event: {dict(why)}")
    assert min(part for part, _ in found) >= least


def test_flood(tmp_path: Path, bundles: Path, say: Say) -> None:
    """Rounds keep their time while each robot gets 2,000 bad datagrams a second."""
    bundle, seconds = build("steps", bundles), scaled(60)
    with Lab(N) as lab, Swarm(lab, bundle, tmp_path / "flood", 0.1) as swarm:
        swarm.start_all().wait(30, lambda: swarm.round() > 5)
        first = swarm.round() + 1
        attack = swarm.flood(seconds, 2000)
        attack.wait()
        last = swarm.round() - 2
        swarm.wait(1)
        swarm.end()
        share, why = current(swarm.lines, first, last)
        dropped = {k: v for k, v in _counters(swarm.lines[0]).items() if k.startswith("dropped")}
        say(f"{share:.3%} of robot-rounds current in {last - first + 1} rounds; no event: {dict(why)}; {dropped}")
        assert sum(dropped.values()) > 1000 * seconds
        assert share >= 0.999


def _counters(lines: Sequence[dict[str, Any]]) -> dict[str, int]:
    found: dict[str, int] = {}
    for t in rounds(lines):
        found |= t.get("counters", {})
    return found
