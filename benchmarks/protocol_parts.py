"""Measure each part of the receive path in C by switching it off: `python benchmarks/protocol_parts.py [--quick]`.

Variants, in turns, in one run; `all` is the product as it is:

    no courier   waiting, receiving and sending by Python's socket module (courier.c)
    no coupling  courier and gate are there, and know nothing of each other
    no gate      datagrams are authenticated and read in Python (gate.c with mac.h, blake2s.h, msgpack.h)
    no ledger    the gate authenticates and reads, and the memory is told of each message (ledger.h)
    no voice     own words are put together and sealed in Python (voice.h)
    none         plain Python

Three figures for each: time to consistency (median over robots and rounds), CPU of a robot's round (median over
robots), and the round trip of an update between two robots. One robot a process, full stack of the shared memory
without agents around it (see peers_memory). Ratios are to `all`; more than 1 is slower than with all parts.

"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.peers_exchange import Place
from benchmarks.peers_memory import open_memory, open_update
from benchmarks.shared_memory import Failed, round_trip, rounds
from koordgen.runtime.net import courier, gate
from koordgen.runtime.net.link import Link
from koordgen.runtime.net.speech import Speech

NOT_WANTED = "not wanted"
FLEETS = ((5, 0.1), (5, 0.01), (16, 0.01), (32, 0.05))  # robots, delta (s)


def _no_courier() -> None:
    courier.COMPILED.found = NOT_WANTED


def _no_gate() -> None:
    gate.COMPILED.found = NOT_WANTED


def _no_coupling() -> None:
    Link._couple = lambda self: None  # type: ignore[method-assign]


def _no_ledger() -> None:
    Link.attach = lambda self, ledger: None  # type: ignore[method-assign]
    _no_voice()  # which reads the ledger


def _no_voice() -> None:
    Speech.own = lambda self, *given: False  # type: ignore[method-assign]


def _none() -> None:
    _no_courier()
    _no_gate()


VARIANTS: dict[str, Callable[[], None]] = {
    "all": lambda: None,
    "no courier": _no_courier,
    "no coupling": _no_coupling,
    "no gate": _no_gate,
    "no ledger": _no_ledger,
    "no voice": _no_voice,
    "none": _none,
}


def opened(variant: str, open_: Callable[[Place], Any], place: Place) -> Any:
    """Runs in a robot's own process, so that what is switched off is so there alone."""
    VARIANTS[variant]()
    return open_(place)


def figures(variant: str, n: int, delta: float, count: int) -> dict[str, float]:
    """Raises Failed."""
    found = rounds(partial(opened, variant, open_memory), n, delta, count)
    return {"consistency_ms": statistics.median(found.took) * 1e3, "cpu_us": found.cpu * 1e6, "missed": found.missed}


def trip(variant: str, count: int) -> dict[str, float]:
    """Raises Failed."""
    return {"round_trip_us": round_trip(partial(opened, variant, open_update), count) * 1e6}


def measure(label: str, runs: int, one: Callable[[str], dict[str, float]]) -> dict[str, dict[str, float]]:
    """Medians over runs that take turns; prints a table with ratios to `all`."""
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
        base = medians.get("all", {})
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
