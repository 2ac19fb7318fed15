"""Statistics of links and rounds: counters, and histograms of fixed size. Updates take constant time."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

PER_OCTAVE = 8  # buckets per octave (a factor of 2 in duration); the error of a quantile is at most 9 %
_SHORTEST = 1e-6  # seconds; shorter durations count as this duration
BUCKETS = 32 * PER_OCTAVE  # number of buckets; they cover durations of up to 71 minutes
MOST_UNCOUNTED = 64  # number of calls of Metrics.heard after which their arrivals are counted as one batch
RECENT = 512  # number of datagrams after which older datagrams count half in the loss rate


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
    discarded: int = 0  # faults of events that were not finished by the publish deadline
    lost_contention: int = 0  # transactions that lost the lock to another robot's transaction
    current: int = 0  # rounds in which the robot's shared state was current in time
    asked: int = 0  # NACKs sent for missing entries
    out: int = 0  # rounds in which the robot had no valid shared state
    in_a_row: int = 0  # present number of consecutive rounds without current state or without time for an event


_COUNTED = tuple(f.name for f in fields(RoundCounters))


def tally(
    rejected: Mapping[str, int], troubles: Mapping[str, int], slow_calls: int, counters: RoundCounters | None
) -> dict[str, int]:
    """Return name -> count of all counters. Dropped datagrams have one counter for each reason."""
    counted = {f"dropped: {k}": v for k, v in rejected.items()} | {f"network: {k}": v for k, v in troubles.items()}
    if slow_calls:
        counted["slow calls"] = slow_calls
    return counted if counters is None else counted | {name: getattr(counters, name) for name in _COUNTED}


# Arrival of a round message: pid of the sender, increase of the sender's round number, seconds in the network (None if
# unknown). The increase is 1 if no message is missing, k if k - 1 messages are missing. A plain tuple is fastest.
Arrival = tuple[int, int, float | None]


@dataclass(slots=True)
class _PeerFigures:
    """Statistics of one peer. `heard`: time of its last message. `longest`: its longest silence (s)."""

    expected: int = 0
    received: int = 0
    heard: float = -math.inf
    longest: float = 0.0
    closed: int = 0
    repeats: int = 0
    delays: Histogram = field(default_factory=Histogram)


class Metrics:
    """Statistics of robot `pid` in a fleet of `n_sys` robots. Times are seconds of one monotonic clock."""

    def __init__(self, pid: int, n_sys: int) -> None:
        self._pid = pid
        self._peers = [_PeerFigures() for _ in range(n_sys)]
        self._late = Histogram()
        self._uncounted: list[tuple[Iterable[Arrival], float]] = []  # (arrivals, time) of calls of `heard`
        self._round = 0
        self._rounds = self._current = self._events = 0
        self._skipped: dict[str, int] = {}

    def heard(self, arrivals: Iterable[Arrival], now: float) -> None:
        """Count authentic round messages that have arrived by the local time `now`.

        The messages are counted later in batches, because the statistics of peers are far apart in memory."""
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
        """Record for each robot the last round up to which its entries are held; `rounds` is indexed by pid."""
        for peer, round_ in zip(self._peers, rounds, strict=True):
            peer.closed = max(peer.closed, round_)

    def repeated(self, pid: int) -> None:
        """Count a retransmission that was requested from peer `pid`."""
        self._peers[pid].repeats += 1

    def round(self, number: int, late: float, event: str | None, skipped: str | None, current: bool) -> None:
        """Count the event of an application in round `number`. With several, a round is counted with its first record.

        late: seconds from the round's tick until the robot decided which event to run.
        skipped: reason why no event could run, or None.
        """
        if number > self._round:
            self._round = number
            self._late.add(late)
            self._rounds += 1
            self._current += current
        self._events += event is not None
        if skipped is not None and (skipped in self._skipped or len(self._skipped) < 32):
            self._skipped[skipped] = self._skipped.get(skipped, 0) + 1

    def snapshot(self, now: float, rejected: Mapping[str, int]) -> dict[str, Any]:
        """Return the statistics as plain values.

        Names with `_ms` are milliseconds. `loss` is the lost share of recent messages. `behind` counts rounds."""
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
