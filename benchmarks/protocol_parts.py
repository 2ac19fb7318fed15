"""Comparison of the socket I/O in C with that in Python: `python benchmarks/protocol_parts.py [--quick]`.

Variants, which take turns in one run:

    socket_batch      the product: socket_batch.c waits, receives and sends
    no socket_batch   Python's socket module, as on a computer without a C compiler

Three figures for each: time to consistency (median over robots and rounds), CPU of a robot's round (median over
robots), and the round trip of an update between two robots. Each robot has its own process with the full stack of the
shared memory, without an agent (see peers_memory). Ratios are relative to `socket_batch`; more than 1 is slower.
docs/adr/0048-what-each-part-in-c-buys.md has figures of other parts that once were in C.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.peers_memory import open_memory, open_update
from benchmarks.shared_memory import Failed, round_trip, rounds

FLEETS = ((5, 0.1), (5, 0.01), (16, 0.01), (32, 0.05))  # robots, delta (s)
BASE = "socket_batch"
VARIANTS = {BASE: True, "no socket_batch": False}  # True if C code reads the sockets


def figures(variant: str, n: int, delta: float, count: int) -> dict[str, float]:
    """Return the figures of one run. Raises Failed."""
    found = rounds(partial(open_memory, native=VARIANTS[variant]), n, delta, count)
    return {"consistency_ms": statistics.median(found.took) * 1e3, "cpu_us": found.cpu * 1e6, "missed": found.missed}


def trip(variant: str, count: int) -> dict[str, float]:
    """Return the round-trip time. Raises Failed."""
    return {"round_trip_us": round_trip(partial(open_update, native=VARIANTS[variant]), count) * 1e6}


def measure(label: str, runs: int, one: Callable[[str], dict[str, float]]) -> dict[str, dict[str, float]]:
    """Print a table of medians over runs that take turns, with ratios to BASE."""
    found: dict[str, list[dict[str, float]]] = {variant: [] for variant in VARIANTS}
    for _ in range(runs):
        for variant, runs_of in found.items():
            try:
                runs_of.append(one(variant))
            except Failed as failed:
                print(f"  {label}, {variant}: {failed}")
    medians = {
        variant: {name: statistics.median(run[name] for run in each) for name in each[0]}
        for variant, each in found.items()
        if each
    }
    print(label)
    for variant, values in medians.items():
        base = medians.get(BASE, {})
        shown = [f"{name} {value:9.1f} ({ratio(value, base.get(name))})" for name, value in values.items()]
        print(f"  {variant:12} {'  '.join(shown)}", flush=True)
    return medians


def ratio(value: float, base: float | None) -> str:
    return f"{value / base:.2f}" if base else "-"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--quick", action="store_true", help="under a minute: one run of five robots, few rounds")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there, too")
    options = parser.parse_args()
    runs, seconds = (1, 1.0) if options.quick else (5, 4.0)
    found = {
        f"{n} robots, delta {delta * 1e3:.0f} ms": measure(
            f"{n} robots, delta {delta * 1e3:.0f} ms", runs,
            partial(figures, n=n, delta=delta, count=max(10, round(seconds / delta))),
        )
        for n, delta in (FLEETS[1:2] if options.quick else FLEETS)
    }  # fmt: skip
    found["2 robots"] = measure("2 robots", runs, partial(trip, count=500 if options.quick else 3000))
    if options.json:
        options.json.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
