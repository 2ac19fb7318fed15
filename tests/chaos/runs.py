"""How much the chaos tests do, and several fleets side by side.

The environment's KOORDGEN_CHAOS is a factor of all counts (1: the full ones), KOORDGEN_CHAOS_FLEETS how many real
fleets run at once.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from typing import Any, TypeVar

T = TypeVar("T")
Say = Callable[[str], None]
SCALE = float(os.environ.get("KOORDGEN_CHAOS", "1"))
FLEETS = int(os.environ.get("KOORDGEN_CHAOS_FLEETS", "6"))


def scaled(count: int) -> int:
    return max(1, math.ceil(count * SCALE))


def side_by_side(work: Callable[[int], T], count: int, say: Say, what: str, fleets: int = FLEETS) -> list[T]:
    """`work(0)` to `work(count - 1)`, several fleets at once, and a line of progress now and then."""
    began = told = time.monotonic()
    with ThreadPoolExecutor(min(fleets, count)) as pool:
        results = [pool.submit(work, i) for i in range(count)]
        waiting: Iterable[Future[Any]] = results
        while waiting:
            done, waiting = wait(waiting, timeout=5, return_when=FIRST_COMPLETED)
            for future in done:
                if future.exception() is not None:  # the first that fails ends the others that have not begun
                    pool.shutdown(wait=False, cancel_futures=True)
            if time.monotonic() > told + 20 or not waiting:
                told = time.monotonic()
                ready = sum(f.done() for f in results)
                say(f"{what}: {ready} of {count} after {told - began:.0f} s")
        return [f.result() for f in results]
