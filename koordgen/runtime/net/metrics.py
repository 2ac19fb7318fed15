"""Statistics of links and rounds: counts and histograms of fixed size, each update O(1)."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

PER_OCTAVE = 8  # buckets per octave: a quantile is right within 9 %
_SHORTEST = 1e-6  # seconds
BUCKETS = 32 * PER_OCTAVE  # up to more than an hour
MOST_UNCOUNTED = 64  # calls of Metrics.heard after which the arrivals are counted as one batch
RECENT = 512  # datagrams after which the weight of older ones is halved


class Histogram:
    """Histogram of durations in seconds, with buckets of an eighth of an octave.

    A duration below a microsecond counts as a microsecond."""

    __slots__ = ("_buckets", "_most")

    def __init__(self) -> None:
        self._buckets = array("Q", bytes(8 * BUCKETS))
        self._most = 0.0

    def add(self, seconds: float) -> None:
        if not -math.inf < seconds < math.inf:
            return
        index = int(PER_OCTAVE * math.log2(seconds / _SHORTEST)) if seconds > _SHORTEST else 0
        self._buckets[index if index < BUCKETS else BUCKETS - 1] += 1
        if seconds > self._most:
            self._most = seconds

    def count(self) -> int:
        return sum(self._buckets)

    def quantile(self, share: float) -> float:
        """Return a duration that at least `share` of all durations do not exceed; 0 without durations."""
        wanted, seen, most = max(1, math.ceil(share * self.count())), 0, self._most
        for index, count in enumerate(self._buckets):
            seen += count
            if seen >= wanted:
                return min(most, _SHORTEST * 2 ** ((index + 1) / PER_OCTAVE))
        return most

    def snapshot(self) -> dict[str, float]:
        """Return p50, p99 and max of the durations in milliseconds; empty without durations."""
        if not self.count():
            return {}
        found = {"p50": self.quantile(0.5), "p99": self.quantile(0.99), "max": self._most}
        return {name: round(seconds * 1e3, 3) for name, seconds in found.items()}


@dataclass(slots=True)
class RoundCounters:
    rounds: int = 0
    skipped: int = 0
    missed: int = 0  # rounds during which the agent did not run
    faults: int = 0
    discarded: int = 0  # faults due to the publish deadline
    gave_way: int = 0  # transactions that lost to another robot's
    current: int = 0  # rounds with current shared state in time
    asked: int = 0  # NACKs sent for missing entries
    out: int = 0  # rounds in which the others continued without this robot
    in_a_row: int = 0  # consecutive rounds, up to now, without current state or time for an event


_COUNTED = tuple(f.name for f in fields(RoundCounters))


def tally(
    rejected: Mapping[str, int], troubles: Mapping[str, int], slow_calls: int, counters: RoundCounters | None
) -> dict[str, int]:
    """Return all counters by name; dropped datagrams by reason."""
    counted = {f"dropped: {k}": v for k, v in rejected.items()} | {f"network: {k}": v for k, v in troubles.items()}
    if slow_calls:
        counted["slow calls"] = slow_calls
    return counted if counters is None else counted | {name: getattr(counters, name) for name in _COUNTED}


# Arrival of a round message: the peer's pid; increase of its round number (1 if no message is missing, k if k - 1 are,
# 0 or less if it is late); seconds in the network, or None. A plain tuple is fastest.
Arrival = tuple[int, int, float | None]


@dataclass(slots=True)
class _PeerFigures:
    """Statistics of one peer. `heard`: time of its last message; `longest`: longest silence (s)."""

    expected: int = 0
    received: int = 0
    heard: float = -math.inf
    longest: float = 0.0
    closed: int = 0
    repeats: int = 0
    delays: Histogram = field(default_factory=Histogram)


class Metrics:
    """Statistics of robot `pid` in a fleet of `n_sys`. Times are seconds of one monotonic clock."""

    def __init__(self, pid: int, n_sys: int) -> None:
        self._pid = pid
        self._peers = [_PeerFigures() for _ in range(n_sys)]
        self._late = Histogram()
        self._uncounted: list[tuple[Iterable[Arrival], float]] = []  # see `heard`
        self._round = 0
        self._rounds = self._current = self._events = 0
        self._skipped: dict[str, int] = {}

    def heard(self, arrivals: Iterable[Arrival], now: float) -> None:
        """Count authentic round messages that have arrived by the local time `now`.

        They are counted in batches, because the statistics of peers are far apart in memory."""
        self._uncounted.append((arrivals, now))
        if len(self._uncounted) >= MOST_UNCOUNTED:
            self._count_all()

    def _count_all(self) -> None:
        uncounted, self._uncounted = self._uncounted, []
        for arrivals, now in uncounted:
            self._count(arrivals, now)

    def _count(self, arrivals: Iterable[Arrival], now: float) -> None:
        for pid, ahead, delay in arrivals:
            peer = self._peers[pid]
            peer.received += 1
            if ahead > 0:
                peer.expected += ahead
                if peer.expected > RECENT:
                    peer.expected //= 2
                    peer.received //= 2
            if delay is not None:
                peer.delays.add(delay)
            silent = now - peer.heard
            peer.heard = now
            if peer.longest < silent < math.inf:
                peer.longest = silent

    def held(self, rounds: Sequence[int]) -> None:
        """Record the round up to which each robot's log entries are held, by pid."""
        for peer, round_ in zip(self._peers, rounds, strict=True):
            peer.closed = max(peer.closed, round_)

    def repeated(self, pid: int) -> None:
        """Count a retransmission requested from a peer."""
        self._peers[pid].repeats += 1

    def round(self, number: int, late: float, event: str | None, skipped: str | None, current: bool) -> None:
        """Count a round that was decided `late` seconds after its tick; `skipped` says why no event could run."""
        self._round = number
        self._late.add(late)
        self._rounds += 1
        self._current += current
        self._events += event is not None
        if skipped is not None and (skipped in self._skipped or len(self._skipped) < 32):
            self._skipped[skipped] = self._skipped.get(skipped, 0) + 1

    def snapshot(self, now: float, rejected: Mapping[str, int]) -> dict[str, Any]:
        """Return plain values.

        Times in milliseconds, `loss` a share of what was sent lately, `behind` in rounds."""
        self._count_all()
        peers = {}
        for pid, peer in enumerate(self._peers):
            if pid == self._pid:
                continue
            lost = max(0, peer.expected - peer.received)
            peers[str(pid)] = {
                "loss": round(lost / peer.expected, 3) if peer.expected else None,
                "delay_ms": peer.delays.snapshot(),
                "silent_ms": None if peer.heard == -math.inf else round((now - peer.heard) * 1e3, 1),
                "longest_silence_ms": round(peer.longest * 1e3, 1),
                "behind": max(0, self._round - 1 - peer.closed),
                "repeats": peer.repeats,
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
