"""Cost of shared memory, beside its peers in the same run: `python benchmarks/shared_memory.py [--quick]`.

1. Round trip of an update (encode, MAC, UDP, verify, decode, apply) between two robots, beside raw UDP with as many
   bytes, Zenoh and CycloneDDS. Each robot has its own core: two robots are two computers, and without this the
   scheduler sometimes puts both on one core, where nothing has to be woken.
2. Time to consistency: 16 robots, rounds of 10 ms, from the tick until a robot has the other 15 updates.
3. The largest fleet in which every robot has every update before the next tick; at real-time priority for all, if the
   system allows it.
4. Four whole agents with rounds of 10 ms: number of entries that are sent late.

One harness drives all of them in the same way. In parts 2 and 3, ours is the full stack of the shared memory (see
`peers_memory`). Whole agents, with sensors, events, monitors, trace and journal, are printed beside it without a
target, since the peers have none of these. A round in which one of our robots had no update counts as never
consistent.

Raw UDP means blocking sockets, and the peers wait in the same way. Nearly all of that time is needed to wake an idle
core: if both sides poll without a pause it takes a fifth or less, which is printed without a target. Ours polls for at
most 0.2 ms before it sleeps, as long as that saves time (see "Sockets" in docs/explanation/shared-memory.md); this is
the main reason for its shorter round trip.

Ours runs compiled, as on a robot after `--compile`; with `--interpreted` it does not. Figures are medians over runs
that take turns. The peers are installed with `pip install 'koordgen[bench]'`; without them only our figures are
printed.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import os
import random
import socket
import statistics
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import wait
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks import peers_agents, peers_exchange
from benchmarks.compiled import restart_compiled
from benchmarks.peers_exchange import PEERS, Make, Place, Polled, Raw, keep_rounds, meet, ping, warm_up
from benchmarks.peers_memory import open_memory, open_update, without_courier
from koordgen.runtime.agent.process import settle_collector
from koordgen.runtime.net import inbox

KOORDGEN, UNICAST, PLAIN, AGENTS = "koordgen", "koordgen, unicast", "koordgen, Python sockets", "koordgen, whole agents"
WHOLE_MEMORY = "koordgen, full stack"
RAW, POLLED = "raw", "raw, both sides polling"
BESIDE = {UNICAST, PLAIN, AGENTS, POLLED, WHOLE_MEMORY}  # printed, without a target
DISTURBED = 4  # additional tries
LONG = 3.0  # seconds of each run of part 3: some 45 runs of 5 to 15 s in all
SIZE = 230  # bytes of a robot's update
TARGETS = {0.01: 24, 0.05: 64, 0.1: 96}  # delta (s) -> robots
SIZES = {  # delta (s) -> sizes of fleets; seven sizes need three steps of bisection
    0.01: (4, 8, 12, 16, 20, 24, 32),
    0.05: (12, 16, 24, 32, 48, 64, 80),
    0.1: (16, 32, 48, 64, 80, 96, 128),
}
_processes = multiprocessing.get_context("fork")
Figures = dict[str, Any]


def free_ports(n: int) -> list[int]:
    """Return ports that are free for UDP and TCP, below those that the kernel assigns to connections."""
    found: list[int] = []
    for port in range(random.randrange(10_000, 25_000), 32_000):
        with suppress(OSError), ExitStack() as stack:
            for kind in (socket.SOCK_DGRAM, socket.SOCK_STREAM):
                stack.enter_context(socket.socket(socket.AF_INET, kind)).bind(("127.0.0.1", port))
            found.append(port)
        if len(found) == n:
            break
    return found


class Failed(Exception):
    """Raised for a run that did not finish. The message gives the reason."""


def together(work: Callable[..., Any], n: int, limit: float) -> list[Any]:
    """Run `work(pid, ports, barrier, start)` in n processes. Return their results. Raises Failed.

    Each process has a port, and there is one more for the group.
    """
    ports, barrier, start = free_ports(n + 1), _processes.Barrier(n), _processes.Value("d", 0.0)
    ends = [_processes.Pipe(duplex=False) for _ in range(n)]

    def child(pid: int) -> None:
        try:
            ends[pid][1].send(work(pid, ports, barrier, start))
        except Exception as error:
            ends[pid][1].send(f"{type(error).__name__}: {error}")

    children = [_processes.Process(target=child, args=(pid,), daemon=True) for pid in range(n)]
    end = time.monotonic() + limit
    try:
        for process in children:
            process.start()
        results: dict[int, Any] = {}
        while len(results) < n:
            ready = wait([ends[pid][0] for pid in range(n) if pid not in results], end - time.monotonic())
            if not ready:
                raise Failed(f"not done within {limit:.0f} s")
            for pid in (p for p in range(n) if ends[p][0] in ready):
                result = results[pid] = ends[pid][0].recv()
                if isinstance(result, str):
                    raise Failed(f"robot {pid}: {result}")
        return [results[pid] for pid in range(n)]
    finally:
        for process in children:
            process.kill()
            process.join()
        for receive, send in ends:
            receive.close()
            send.close()


def round_trip(make: Make, count: int, size: int = SIZE) -> float:
    """Return the median round-trip time (s)."""

    def work(pid: int, ports: Sequence[int], barrier: Any, start: Any) -> list[float]:
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {cores[pid % len(cores)]})
        exchange = make(Place(pid, ports, size, 1.0, Path(folder)))
        if not isinstance(exchange, Raw):
            meet(exchange, 2)
            barrier.wait()
            time.sleep(0.3)  # until no datagram is in transit
            exchange.take(0.0)
        settle_collector()
        barrier.wait()
        return ping(exchange, pid, count)

    with TemporaryDirectory() as folder:
        took: list[float] = together(work, 2, 60)[0]
    return statistics.median(took)


def agents(transport: str, n: int, delta: float, count: int, patience: float = 60.0) -> list[Figures]:
    def work(pid: int, ports: Sequence[int], barrier: Any, start: Any) -> Figures:
        return peers_agents.run_agent(pid, ports, transport, delta, count, SIZE, patience, Path(folder))

    with TemporaryDirectory() as folder:
        return together(work, n, patience + 10 + 2 * count * delta)


@dataclass(frozen=True)
class Rounds:
    """Results of all robots: seconds to consistency of each round, missed rounds, and CPU seconds of one robot's round.

    A round in which a robot had no update has infinite time. CPU is the median.
    """

    took: list[float]
    missed: int
    cpu: float


def rounds(make: Make, n: int, delta: float, count: int) -> Rounds:
    """Run rounds. Return their results. Raises Failed."""
    warm = warm_up(delta)

    def work(pid: int, ports: Sequence[int], barrier: Any, start: Any) -> tuple[list[float], list[int], float]:
        exchange = make(Place(pid, ports, SIZE, delta, Path(folder)))
        meet(exchange, n)
        settle_collector()
        barrier.wait()
        if pid == 0:
            start.value = time.monotonic() + 0.5
        barrier.wait()
        exchange.take(0.0)
        before = time.process_time()
        took = keep_rounds(exchange, n, delta, start.value, warm + count)
        return took, list(exchange.missed), (time.process_time() - before) / (warm + count)

    with TemporaryDirectory() as folder:
        robots = together(work, n, 60 + count * delta)
    empty = {r for _, missed, _ in robots for r in missed}
    counted = range(warm + 1, warm + count + 1)
    return Rounds(
        [math.inf if r in empty else took[r - 1] for took, _, _ in robots for r in counted],
        sum(r > warm for _, missed, _ in robots for r in missed),
        statistics.median(cpu for _, _, cpu in robots),
    )


def whole_agents(network: str, n: int, delta: float, count: int, patience: float = 20.0) -> Rounds:
    """Run rounds of whole agents. Return their results. Raises Failed."""
    robots = agents(network, n, delta, count, patience)
    return Rounds(
        [t for robot in robots for t in robot["consistent"]],
        sum(len(robot["skipped"]) for robot in robots),
        statistics.median(robot["cpu"] for robot in robots),
    )


Measure = Callable[[int, float, int], Rounds]  # (n robots, delta seconds, number of rounds) -> results
OURS: dict[str, Measure] = {KOORDGEN: partial(rounds, open_memory)}
OURS[UNICAST] = partial(rounds, partial(open_memory, network="unicast"))
OURS[PLAIN] = partial(rounds, partial(open_memory, native=False))
WHOLE: Measure = partial(whole_agents, "multicast")


def consistency(name: str, measure: Measure, n: int, delta: float, count: int) -> float:
    """Return the median time to consistency (s). Raises Failed."""
    found = measure(n, delta, count)
    cpu = found.cpu
    print(f"  {name}: {cpu * 1e6:.0f} us of CPU in a robot's round, {cpu * n * 1e3:.1f} ms in the fleet's", end="")
    print(f"; {found.missed} of {n * count} updates missing" if found.missed else "")
    return statistics.median(found.took)


def taken_away() -> int:
    """Return for how long the host of this virtual machine kept its cores from running, in ticks (10 ms) of all cores.

    It is the eighth number in /proc/stat, see proc(5); 0 if it is not there.
    """
    with suppress(OSError, IndexError, ValueError):
        return int(Path("/proc/stat").read_text().split(maxsplit=9)[8])
    return 0


def keeps(name: str, measure: Measure, n: int, delta: float, count: int, tries: int = 2) -> bool:
    """Return whether each robot had each round's updates of all others before the next tick.

    There are two tries, because other processes may disturb one. Of fleets with a target there are up to DISTURBED
    more, for tries in which the host took cores away. If half of the rounds took too long, the fleet fails at once.
    """
    disturbed = DISTURBED if name in BESIDE else 0
    while tries:
        before = taken_away()
        try:
            found = measure(n, delta, count)
        except Failed as failed:
            print(f"  {name}, {n} robots, delta {delta * 1e3:.0f} ms: {failed}")
            tries -= 1
            continue
        if not found.missed and max(found.took) < delta:
            return True
        if statistics.median(found.took) > delta:
            return False
        if disturbed < DISTURBED and (ticks := taken_away() - before):
            disturbed += 1
            print(f"  {name}, {n} robots, delta {delta * 1e3:.0f} ms: again, as the host took {10 * ticks} ms away")
        else:
            tries -= 1
    return False


def largest(name: str, measure: Measure, delta: float, count: int) -> int:
    """Return the largest fleet of SIZES that keeps its rounds, found by bisection."""
    sizes = SIZES[delta]
    low, high = -1, len(sizes)
    while high - low > 1:
        middle = (low + high) // 2
        if keeps(name, measure, sizes[middle], delta, count):
            low = middle
        else:
            high = middle
    return sizes[low] if low >= 0 else 0


def in_turn(runs: int, measured: Mapping[str, Callable[[], float]]) -> dict[str, float]:
    """Return the median of each measure over `runs` runs that take turns; a failed run counts as infinite."""
    found: dict[str, list[float]] = {name: [] for name in measured}
    for _ in range(runs):
        for name, measure in measured.items():
            try:
                found[name].append(measure())
            except Failed as failed:
                print(f"  {name}: {failed}")
                found[name].append(math.inf)
    return {name: statistics.median(times) for name, times in found.items()}


def part_round_trip(peers: Sequence[str], quick: bool) -> Figures:
    count, runs = (2000, 1) if quick else (5000, 5)
    size = 330  # bytes of a datagram with the update
    measured = {RAW: partial(round_trip, Raw, count, size), KOORDGEN: partial(round_trip, open_update, count)}
    measured |= {name: partial(round_trip, PEERS[name], count) for name in peers}
    measured[WHOLE_MEMORY] = partial(round_trip, partial(open_memory, network="unicast"), count)
    measured[PLAIN] = partial(round_trip, partial(open_update, native=False), count)
    measured[POLLED] = partial(round_trip, Polled, count, size)
    found = in_turn(runs, measured)
    print(f"\n1. Round trip of an update of {SIZE} bytes, two processes, {runs} x {count}")
    for name, seconds in found.items():
        print(f"  {name:24} {seconds * 1e6:8.1f} us{beside(name)}")
    tell(f"{KOORDGEN} / {RAW}", found[KOORDGEN] / found[RAW], "at most", 1.6)
    for name in peers:
        tell(f"{name} / {KOORDGEN}", found[name] / found[KOORDGEN], "at least", 3.0)
    return {name: seconds * 1e6 for name, seconds in found.items()}


def part_consistency(peers: Sequence[str], quick: bool) -> Figures:
    n, delta, count, runs = 16, 0.01, *((100, 1) if quick else (500, 5))
    ours = {KOORDGEN: OURS[KOORDGEN]} if quick else OURS
    measures: dict[str, Measure] = ours | {name: partial(rounds, PEERS[name]) for name in peers} | {AGENTS: WHOLE}
    measured = {name: partial(consistency, name, measure, n, delta, count) for name, measure in measures.items()}
    found = in_turn(runs, measured)
    print(
        f"\n2. Time to consistency, {n} robots, delta {delta * 1e3:.0f} ms, {SIZE} bytes each, {runs} x {count} rounds"
    )
    for name, seconds in found.items():
        print(f"  {name:24} {seconds * 1e3:8.2f} ms{beside(name)}")
    for name, least in (("cyclonedds", 1.5), ("zenoh", 3.0)):
        if name in peers:
            tell(f"{name} / {KOORDGEN}", found[name] / found[KOORDGEN], "at least", least)
    return {name: seconds * 1e3 for name, seconds in found.items()}


@contextmanager
def ahead_of_others() -> Iterator[None]:
    """Run this process and its children at the lowest real-time priority, if the system allows it.

    Reason: if another process occupies one of two cores for 10 ms, a fleet that needs both cores half of the time
    misses a round.
    """
    policy, priority = os.sched_getscheduler(0), os.sched_getparam(0)
    with suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    try:
        yield
    finally:
        os.sched_setscheduler(0, policy, priority)


@ahead_of_others()
def part_largest(peers: Sequence[str], quick: bool) -> Figures:
    figures: Figures = {}
    print("\n3. Largest fleet that misses no round" + (" (only: does ours hold the wanted size?)" if quick else ""))
    measures: dict[str, Measure] = {KOORDGEN: OURS[KOORDGEN]}
    measures |= {name: partial(rounds, PEERS[name]) for name in peers} | {AGENTS: WHOLE}
    for delta, wanted in TARGETS.items():
        count = round((1.0 if quick else LONG) / delta)
        label = f"{delta * 1e3:.0f} ms"
        if quick:
            figures[label] = {KOORDGEN: wanted if keeps(KOORDGEN, OURS[KOORDGEN], wanted, delta, count, tries=1) else 0}
        else:
            figures[label] = {name: largest(name, measure, delta, count) for name, measure in measures.items()}
        sizes = ", ".join(f"{name} {n}" for name, n in figures[label].items())
        tell(f"delta {label}: {sizes}", figures[label][KOORDGEN], "at least", wanted)
    return figures


def part_late(quick: bool) -> Figures:
    n, delta, count = 4, 0.01, 300 if quick else 6000
    print(f"\n4. {n} agents, delta {delta * 1e3:.0f} ms, {count} rounds each")
    try:
        results = agents("multicast", n, delta, count)
    except Failed as failed:
        print(f"  {failed}")
        return {"late": None}
    left = [(t, r["deadline"]) for r in results for t in r["left"]]
    late = sum(t > deadline for t, deadline in left) / len(left)
    skipped = sum(len(r["skipped"]) for r in results) / len(left)
    figures = {"late": late, "skipped": skipped, "left_ms": statistics.median(t for t, _ in left) * 1e3}
    print(f"  entries leave {figures['left_ms']:.2f} ms after the tick (median), {skipped:.3%} of rounds without event")
    tell("share of late entries (%)", late * 100, "below", 0.1)
    return figures


def beside(name: str) -> str:
    return "  (not judged)" if name in BESIDE else ""


def tell(what: str, figure: float, how: str, target: float) -> None:
    good = figure >= target if how == "at least" else figure <= target
    said = f"{figure:8.2f}" if math.isfinite(figure) else "    none"
    print(f"  {what:46} {said}  (wanted: {how} {target:g}{'' if good and math.isfinite(figure) else ': MISSED'})")


def finite(figures: Any) -> Any:
    """Replace infinity, which JSON does not have."""
    if isinstance(figures, dict):
        return {name: finite(figure) for name, figure in figures.items()}
    return figures if figures is None or math.isfinite(figures) else None


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--quick", action="store_true", help="under a minute: one run of each, few rounds")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there, too")
    parser.add_argument("--only", type=int, choices=(1, 2, 3, 4), action="append", help="only this part")
    parser.add_argument("--interpreted", action="store_true", help="ours without compiled modules")
    parser.add_argument("--plain", action="store_true", help="ours without anything in C, sockets neither")
    arguments = parser.parse_args()
    if not (arguments.interpreted or arguments.plain):
        restart_compiled()
    if arguments.plain:
        without_courier()
    if reason := inbox.accelerator():  # without a reason, it is compiled now, for all processes
        print(f"ours is plain Python: {reason}")
    absent = peers_exchange.missing()
    for text in absent.values():
        print(text)
    peers = [name for name in PEERS if name not in absent]
    quick, only = arguments.quick, arguments.only or [1, 2, 3, 4]
    parts: dict[int, tuple[str, Callable[[], Figures]]] = {
        1: ("round_trip_us", lambda: part_round_trip(peers, quick)),
        2: ("consistency_ms", lambda: part_consistency(peers, quick)),
        3: ("largest_fleet", lambda: part_largest(peers, quick)),
        4: ("late", lambda: part_late(quick)),
    }
    figures = {name: part() for number, (name, part) in parts.items() if number in only}
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(finite(figures), indent=2) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
