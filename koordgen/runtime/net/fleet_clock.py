"""Fleet clock: the time of the reference robot, which has the lowest pid of the present view.

Local clocks are monotonic seconds of unknown origin, at most CRYSTAL off the true rate. An exchange with a peer (a
datagram to the peer, and its echo back) has four time stamps. No datagram arrives before it was sent, so the stamps
bound the offset between the two local clocks from both sides, even if the delays differ. The middle of the bounds is
off by at most half of the shortest round trip. The peer also reports fleet time minus its local time; this difference
is constant for the reference."""

from __future__ import annotations

from collections import deque
from functools import reduce
from math import copysign, inf
from typing import NamedTuple

CRYSTAL = 100e-6  # largest relative error of a local clock's rate
DRIFT = 2 * CRYSTAL  # largest relative difference between the rates of two clocks
MOST_DRIFT = 500e-6  # limit for estimates of the relative difference between the rates of two clocks
WANDER = 10e-6  # largest difference between the present rate and the mean rate of the last SLOTS * SLOT seconds
SLOT = 16.0  # seconds of a slot; the tightest bounds of each slot are kept
SLOTS = 32  # number of slots that are kept
APART = 5.0  # seconds that two bounds must be apart to yield an estimate of the rate
ROUNDING = 2e-6  # seconds; largest rounding error, because time stamps are whole microseconds

# Largest correction of a locked clock, as a share of the elapsed time. It keeps fleet time monotonic and rounds even.
SLEW = 0.05
FRESH = 0.02  # seconds for which an estimate is reused; in this time two clocks drift apart by at most 4 microseconds
NO_REFERENCE = -1
STEP = 0.1  # seconds; a larger deviation from the estimate is no estimation error, so a clock was reset


class _Edges(NamedTuple):
    """Bounds of a peer's clock relative to the local clock, in seconds, from one or several exchanges.

    At local time `low_at`, the peer's clock is ahead by at least `low`. At local time `high_at`, it is ahead by at most
    `high`."""

    low_at: float
    low: float
    high_at: float
    high: float

    def merged(self, other: _Edges, rates: tuple[float, float]) -> _Edges:
        """Return the tighter lower bound and the tighter upper bound of `self` and `other`.

        rates: bounds of the peer's rate minus the local rate. They extend a bound to another time.
        """
        low_at, low, high_at, high = self
        if other.low >= low + rates[0] * (other.low_at - low_at):
            low_at, low = other.low_at, other.low
        if other.high <= high + rates[1] * (other.high_at - high_at):
            high_at, high = other.high_at, other.high
        return _Edges(low_at, low, high_at, high)

    def on(self, now: float, rates: tuple[float, float]) -> tuple[float, float]:
        low_at, low, high_at, high = self
        return low + rates[0] * (now - low_at), high + rates[1] * (now - high_at)


class _PeerClock:
    """Estimate of a peer's clock: the tightest bounds in each slot, and the rates that they allow.

    fleet: fleet time minus the peer's local time, as the peer has reported last.
    reported_at: local time at or after which the peer sent that report."""

    def __init__(self) -> None:
        self.fleet: float | None = None
        self.reported_at = -inf
        self.rates = (-DRIFT, DRIFT)  # bounds of the peer's rate minus this clock's rate
        self._slots: deque[_Edges] = deque(maxlen=SLOTS)
        self._number = 0.0  # number of the latest slot
        self._best: _Edges | None = None
        self._odd: _PeerClock | None = None

    def limits(self, now: float) -> tuple[float, float]:
        """Return the least and the greatest lead (s) of the peer's clock over the local clock."""
        return (-inf, inf) if self._best is None else self._best.on(now, self.rates)

    def add(self, edges: _Edges, fleet: float | None) -> _PeerClock:
        """Add an exchange. Return the estimate to use from now on: this one, or a new one.

        A new estimate begins when two successive exchanges agree with each other but contradict this estimate. Then one
        of the two computers was suspended, or the peer's computer was restarted."""
        if self._add(edges, fleet):
            self._odd = None
            return self
        if self._odd is None or not self._odd._add(edges, fleet):
            self._odd = _PeerClock()
            self._odd._add(edges, fleet)
            return self
        return self._odd

    def _add(self, edges: _Edges, fleet: float | None) -> bool:
        """Add an exchange. If it contradicts the estimate, change nothing and return False."""
        now = edges.low_at
        best = edges if self._best is None else self._best.merged(edges, self.rates)
        low, high = best.on(now, self.rates)
        if low > high or (fleet is not None and self.fleet is not None and abs(fleet - self.fleet) > STEP):
            return False
        if fleet is not None and edges.high_at >= self.reported_at:
            self.fleet, self.reported_at = fleet, edges.high_at
        self._best = best
        number = now // SLOT
        if self._slots and number == self._number:
            self._slots[-1] = self._slots[-1].merged(edges, self.rates)
        else:
            self._number = number
            self._slots.append(edges)
            self._learn(now)
        return True

    def _learn(self, now: float) -> None:
        """Estimate the rates from older and newer slots. Then compute the tightest bounds with these rates."""
        half = len(self._slots) // 2
        slots = list(self._slots)
        slowest, fastest = -inf, inf
        for old in slots[:half]:
            for new in slots[half:]:
                if new.low_at - old.high_at >= APART:
                    slowest = max(slowest, (new.low - old.high) / (new.low_at - old.high_at))
                if new.high_at - old.low_at >= APART:
                    fastest = min(fastest, (new.high - old.low) / (new.high_at - old.low_at))
        slowest, fastest = slowest - WANDER, fastest + WANDER
        if max(slowest, -DRIFT) <= min(fastest, DRIFT):
            slowest, fastest = max(slowest, -DRIFT), min(fastest, DRIFT)
        self.rates = (max(-MOST_DRIFT, min(MOST_DRIFT, slowest)), max(-MOST_DRIFT, min(MOST_DRIFT, fastest)))
        self._best = reduce(lambda a, b: a.merged(b, self.rates), slots)
        low, high = self._best.on(now, self.rates)
        if (
            slowest > fastest or low > high
        ):  # the rate has changed by more than WANDER, so only the newest bounds are valid
            self.rates = (-DRIFT, DRIFT)
            self._slots = deque(slots[-1:], maxlen=SLOTS)
            self._best = slots[-1]


class FleetClock:
    """Fleet time on robot `pid`.

    Before `lock` is called, fleet time steps to the best estimate. After `lock`, it approaches the estimate by small
    corrections and never goes back. Only a lag above STEP is corrected at once.

    Robot 0 is the first reference, and its local time is the fleet time. A robot that becomes the reference continues
    its own estimate at the rate of its own clock. The other robots follow that robot's fleet time."""

    def __init__(self, pid: int) -> None:
        self.reference = 0
        self.breaks = 0  # number of times that the reference's or the local clock was reset
        self._pid = pid
        self._exchanges: dict[int, _PeerClock] = {}
        self._known = pid == self.reference
        self._followed = -inf
        self._offset = 0.0
        self._locked = False
        self._estimated = -inf  # local time at which fleet time last reached a new estimate
        self._last = -inf

    @property
    def known(self) -> bool:
        """True if fleet time is known: this robot has an estimate or is the reference."""
        return self._known

    @property
    def drift(self) -> float:
        """Relative difference between clock rates: the reference's rate minus the local rate."""
        peer = self._exchanges.get(self.reference)
        return 0.0 if peer is None or self.reference == self._pid else sum(peer.rates) / 2

    def bound(self, now: float) -> float:
        """Return the largest possible error (s) of fleet time at local time `now`.

        Without data of the reference, the result is inf. After a computer was suspended, the result is wrong until two
        further exchanges have arrived."""
        if self.reference == self._pid:
            return 0.0
        estimate = self._estimate(now)
        return inf if estimate is None else estimate[1] + abs(estimate[0] - self._offset)

    def offset(self, now: float) -> float | None:
        """Return fleet time minus local time (s), which messages report to other robots; None if unknown."""
        if not 0.0 <= now - self._estimated < FRESH or now < self._last:
            self.read(now)
        else:
            self._last = now
        return self._offset if self._known else None

    def forget(self) -> None:
        """Know no fleet time until `follow` is called: the time of a mission that runs is not that of the local clock.

        An agent calls this if it rejoins. Its computer may have been restarted, or the agent moved to another one."""
        self.reference = NO_REFERENCE
        self._known = False

    def follow(self, reference: int, now: float) -> None:
        """Follow robot `reference` from now on. Earlier exchanges with that robot are used as well."""
        if reference == self.reference:
            return
        self.read(now)
        if self.reference == self._pid and not self._locked:
            self._known = False  # no other robot has used this robot's fleet time yet
        self.reference = reference
        self._followed = now
        self._estimated = -inf
        self._known = self._known or reference == self._pid or self._estimate(now) is not None

    def add(self, peer: int, sent: float, received: float, answered: float, now: float, fleet: float | None) -> bool:
        """Add an exchange with a peer. Return False for time stamps that no honest exchange yields.

        sent, now: local times (s) at which this robot sent its datagram and received the answer.
        received, answered: times (s) on the peer's clock at which the peer received the datagram and answered.
        fleet: fleet time minus the peer's local time (s), as the peer reports it; None if unknown to the peer."""
        edges = _Edges(now, answered - now - ROUNDING, sent, received - sent + ROUNDING)
        low, high = edges.on(now, (-DRIFT, DRIFT))
        if not (peer != self._pid and sent <= now and received <= answered and low <= high):
            return False
        before = self._exchanges.get(peer) or _PeerClock()
        after = self._exchanges[peer] = before.add(edges, fleet)
        self._estimated = -inf
        if peer == self.reference:
            self.breaks += after is not before
            self._known = self._known or after.fleet is not None
        return True

    def lock(self) -> None:
        """Forbid fleet time to go back from now on, because the start of the mission is fixed."""
        self._locked = True

    def read(self, now: float) -> float:
        """Return the fleet time at local time `now`. After `lock`, it decreases only if `now` decreases."""
        if 0.0 <= now - self._estimated < FRESH:
            if now > self._last:
                self._last = now
            return now + self._offset
        self._estimated = now
        estimate = self._estimate(now)
        if estimate is not None:
            wanted = estimate[0] - self._offset
            if self._locked and wanted <= STEP + estimate[1]:
                most = SLEW * max(0.0, now - self._last)
                if abs(wanted) > most:
                    wanted = copysign(most, wanted)
                    self._estimated = -inf  # later calls correct the remaining deviation
            self._offset += wanted
        self._last = max(self._last, now)
        return now + self._offset

    def local(self, fleet: float) -> float:
        """Return the local time at which fleet time will be `fleet`, by the present estimate."""
        return fleet - self._offset

    def _estimate(self, now: float) -> tuple[float, float] | None:
        """Return fleet time minus local time as reported by the reference, and the largest error (s)."""
        peer = self._exchanges.get(self.reference)
        if peer is None or peer.fleet is None or self.reference == self._pid:
            return None
        low, high = peer.limits(now)
        # The report is older than the change of reference: the peer itself still followed another robot then.
        moved = SLEW * max(0.0, now - peer.reported_at) if peer.reported_at < self._followed else 0.0
        return peer.fleet + (low + high) / 2, (high - low) / 2 + moved
