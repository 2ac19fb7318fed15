"""How well a robot hears its peers and keeps its rounds: counts and histograms of fixed size, each note O(1)."""

from __future__ import annotations

import math
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

PER_OCTAVE = 8  # buckets: a quantile is right within 9 %
_SHORTEST = 1e-6  # seconds
BUCKETS = 32 * PER_OCTAVE  # up to more than an hour
RECENT = 512  # datagrams after which older ones count half


class Histograms:
    """Durations in seconds, of several kinds side by side in one piece of memory: what is noted of many peers at once
    touches little of it. What is below a microsecond counts as one."""

    __slots__ = ("_buckets", "_most")

    def __init__(self, kinds: int = 1) -> None:
        self._buckets = array("Q", bytes(8 * BUCKETS * kinds))
        self._most = array("d", bytes(8 * kinds))

    def add(self, seconds: float, kind: int = 0) -> None:
        if not -math.inf < seconds < math.inf:
            return
        index = int(PER_OCTAVE * math.log2(seconds / _SHORTEST)) if seconds > _SHORTEST else 0
        self._buckets[kind * BUCKETS + (index if index < BUCKETS else BUCKETS - 1)] += 1
        if seconds > self._most[kind]:
            self._most[kind] = seconds

    def columns(self) -> Mapping[str, array[int] | array[float]]:
        return {"delays": self._buckets, "most": self._most}

    def count(self, kind: int = 0) -> int:
        return sum(self._of(kind))

    def quantile(self, share: float, kind: int = 0) -> float:
        """What at least this share of all durations does not exceed; 0 when there is none."""
        wanted, seen, most = max(1, math.ceil(share * self.count(kind))), 0, self._most[kind]
        for index, count in enumerate(self._of(kind)):
            seen += count
            if seen >= wanted:
                return min(most, _SHORTEST * 2 ** ((index + 1) / PER_OCTAVE))
        return most

    def snapshot(self, kind: int = 0) -> dict[str, float]:
        """In milliseconds: p50, p99, max; empty when there was none."""
        if not self.count(kind):
            return {}
        found = {"p50": self.quantile(0.5, kind), "p99": self.quantile(0.99, kind), "max": self._most[kind]}
        return {name: round(seconds * 1e3, 3) for name, seconds in found.items()}

    def _of(self, kind: int) -> array[int]:
        return self._buckets[kind * BUCKETS : (kind + 1) * BUCKETS]


@dataclass(slots=True)
class Counters:
    rounds: int = 0
    skipped: int = 0
    missed: int = 0  # slept through
    faults: int = 0
    discarded: int = 0  # faults by the publish deadline
    gave_way: int = 0  # commits that did not count because another robot's did
    current: int = 0  # rounds in which the shared state was there in time
    asked: int = 0  # times that missing closings were asked for
    out: int = 0  # rounds in which the others went on without this robot
    in_a_row: int = 0  # rounds until now without current state or time for an event


_COUNTED = tuple(f.name for f in fields(Counters))


def tally(
    rejected: Mapping[str, int], troubles: Mapping[str, int], slow_calls: int, counters: Counters | None
) -> dict[str, int]:
    """Everything counted, by its name; datagrams by the reason they were dropped for."""
    counted = {f"dropped: {k}": v for k, v in rejected.items()} | {f"network: {k}": v for k, v in troubles.items()}
    if slow_calls:
        counted["slow calls"] = slow_calls
    return counted if counters is None else counted | {name: getattr(counters, name) for name in _COUNTED}


class Metrics:
    """Of robot `pid` in a fleet of `n_sys`. Times are seconds of one monotonic clock."""

    def __init__(self, pid: int, n_sys: int) -> None:
        self._pid = pid
        self._peers = [p for p in range(n_sys) if p != pid]
        # By pid; arrays, since every datagram of a round touches them for another peer.
        none = bytes(8 * n_sys)
        self._expected, self._received = array("q", none), array("q", none)
        self._heard, self._longest = array("d", [-math.inf] * n_sys), array("d", none)  # when; seconds of silence
        self._closed, self._repeats = array("q", none), array("q", none)
        self._delays, self._late = Histograms(n_sys), Histograms()
        self._round = 0
        self._rounds = self._current = self._events = 0
        self._skipped: dict[str, int] = {}

    def heard(self, pid: int, ahead: int, delay: float | None, now: float) -> None:
        """A genuine datagram of a peer. `ahead`: by how much it moved on the count of those that were sent to us; 1
        when none is missing, k when k - 1 are, 0 or less when it comes late. `delay`: seconds under way, None: not
        known."""
        self._received[pid] += 1
        if ahead > 0:
            self._expected[pid] += ahead
            if self._expected[pid] > RECENT:
                self._expected[pid] //= 2
                self._received[pid] //= 2
        if delay is not None:
            self._delays.add(delay, pid)
        silent = now - self._heard[pid]
        self._heard[pid] = now
        if self._longest[pid] < silent < math.inf:
            self._longest[pid] = silent

    def columns(self) -> Mapping[str, array[int] | array[float]]:
        """Those that `heard` changes, and the gate too (gate.c)."""
        counts = {"received": self._received, "expected": self._expected}
        return {**counts, "heard": self._heard, "longest": self._longest, **self._delays.columns()}

    def held(self, rounds: Sequence[int]) -> None:
        """All closings of each robot are here up to these rounds, by pid."""
        for pid, round_ in enumerate(rounds):
            if round_ > self._closed[pid]:
                self._closed[pid] = round_

    def repeated(self, pid: int) -> None:
        """A peer was asked for something again."""
        self._repeats[pid] += 1

    def round(self, number: int, late: float, event: str | None, skipped: str | None, current: bool) -> None:
        """A round was decided `late` seconds after its tick; `skipped` says why no event could run."""
        self._round = number
        self._late.add(late)
        self._rounds += 1
        self._current += current
        self._events += event is not None
        if skipped is not None and (skipped in self._skipped or len(self._skipped) < 32):
            self._skipped[skipped] = self._skipped.get(skipped, 0) + 1

    def snapshot(self, now: float, rejected: Mapping[str, int]) -> dict[str, Any]:
        """Plain values; times in milliseconds, `loss` a share of what was sent lately, `behind` in rounds."""
        peers = {}
        for pid in self._peers:
            expected, heard = self._expected[pid], self._heard[pid]
            lost = max(0, expected - self._received[pid])
            peers[str(pid)] = {
                "loss": round(lost / expected, 3) if expected else None,
                "delay_ms": self._delays.snapshot(pid),
                "silent_ms": None if heard == -math.inf else round((now - heard) * 1e3, 1),
                "longest_silence_ms": round(self._longest[pid] * 1e3, 1),
                "behind": max(0, self._round - 1 - self._closed[pid]),
                "repeats": self._repeats[pid],
            }
        return {
            "rounds": self._rounds,
            "current": self._current,
            "events": self._events,
            "skipped": dict(self._skipped),
            "late_ms": self._late.snapshot(),
            "rejected": dict(rejected),
            "peers": peers,
        }
