"""How well a robot hears its peers and keeps its rounds: counts and histograms of fixed size, each note O(1)."""

from __future__ import annotations

import math
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

_PER_OCTAVE = 8  # buckets: a quantile is right within 9 %
_SHORTEST = 1e-6  # seconds
_BUCKETS = 32 * _PER_OCTAVE  # up to more than an hour
_RECENT = 512  # datagrams after which older ones count half


class Histogram:
    """Durations in seconds; what is below a microsecond counts as one."""

    __slots__ = ("_buckets", "count", "most")

    def __init__(self) -> None:
        self.count = 0
        self.most = 0.0
        self._buckets = array("L", bytes(array("L").itemsize * _BUCKETS))

    def add(self, seconds: float) -> None:
        if not -math.inf < seconds < math.inf:
            return
        index = int(_PER_OCTAVE * math.log2(seconds / _SHORTEST)) if seconds > _SHORTEST else 0
        self._buckets[index if index < _BUCKETS else -1] += 1
        self.count += 1
        if seconds > self.most:
            self.most = seconds

    def quantile(self, share: float) -> float:
        """What at least this share of all durations does not exceed; 0 when there is none."""
        wanted, seen = max(1, math.ceil(share * self.count)), 0
        for index, count in enumerate(self._buckets):
            seen += count
            if seen >= wanted:
                return min(self.most, _SHORTEST * 2 ** ((index + 1) / _PER_OCTAVE))
        return self.most

    def snapshot(self) -> dict[str, float]:
        """In milliseconds: p50, p99, max; empty when there was none."""
        if not self.count:
            return {}
        found = {"p50": self.quantile(0.5), "p99": self.quantile(0.99), "max": self.most}
        return {name: round(seconds * 1e3, 3) for name, seconds in found.items()}


@dataclass(slots=True)
class _Peer:
    """What is known of one peer's datagrams."""

    expected: int = 0
    received: int = 0
    delay: Histogram = field(default_factory=Histogram)
    heard: float | None = None
    longest: float = 0.0  # seconds between two datagrams
    closed: int = 0
    repeats: int = 0


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
        self._peers = {p: _Peer() for p in range(n_sys) if p != pid}
        self._late = Histogram()
        self._round = 0
        self._rounds = self._current = self._events = 0
        self._skipped: dict[str, int] = {}

    def heard(self, pid: int, ahead: int, delay: float | None, now: float) -> None:
        """A genuine datagram of a peer. `ahead`: by how much it moved on the count of those that were sent to us; 1
        when none is missing, k when k - 1 are, 0 or less when it comes late. `delay`: seconds under way, None: not
        known."""
        peer = self._peers[pid]
        peer.received += 1
        if ahead > 0:
            peer.expected += ahead
            if peer.expected > _RECENT:
                peer.expected //= 2
                peer.received //= 2
        if delay is not None:
            peer.delay.add(delay)
        before, peer.heard = peer.heard, now
        if before is not None and now - before > peer.longest:
            peer.longest = now - before

    def held(self, rounds: Sequence[int]) -> None:
        """All closings of each robot are here up to these rounds, by pid."""
        for pid, peer in self._peers.items():
            if rounds[pid] > peer.closed:
                peer.closed = rounds[pid]

    def repeated(self, pid: int) -> None:
        """A peer was asked for something again."""
        self._peers[pid].repeats += 1

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
        for pid, peer in self._peers.items():
            lost = max(0, peer.expected - peer.received)
            peers[str(pid)] = {
                "loss": round(lost / peer.expected, 3) if peer.expected else None,
                "delay_ms": peer.delay.snapshot(),
                "silent_ms": None if peer.heard is None else round((now - peer.heard) * 1e3, 1),
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
