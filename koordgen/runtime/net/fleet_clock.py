"""Fleet clock: the time of the reference robot, which has the lowest pid of the present view.

Local clocks are monotonic seconds of unknown origin, at most CRYSTAL off the true rate. An exchange with a peer (a
datagram to it, and its echo back) has four time stamps. As no datagram arrives before it was sent, they bound the
offset between the two local clocks from both sides, however unequal the two delays are. The middle of the bounds is off
by at most half of the shortest round trip. The peer reports the offset of fleet time to its local time, which is
constant for the reference."""

from __future__ import annotations

from collections import deque
from functools import reduce
from math import copysign, inf
from typing import NamedTuple

CRYSTAL = 100e-6
DRIFT = 2 * CRYSTAL  # largest relative difference of two clocks' rates
MOST_DRIFT = 500e-6  # bound of every estimate of that difference
WANDER = 10e-6  # bound of the difference between the present rate and the mean rate of the last SLOTS * SLOT seconds
SLOT = 16.0  # seconds of a slot; the best bounds of each slot are kept
SLOTS = 32  # number of slots kept
APART = 5.0  # seconds between two bounds that yield an estimate of the rate
ROUNDING = 2e-6  # stamps are whole microseconds
# Largest correction of a locked clock, as a share of the elapsed time. It keeps the clock monotonic and rounds even.
SLEW = 0.05
FRESH = 0.02  # seconds for which an estimate is reused: two clocks drift apart by at most four microseconds
STEP = 0.1  # seconds; a larger deviation of an estimate is not an estimation error


class _Edges(NamedTuple):
    """Bounds of the peer's clock relative to this one, from one exchange or the best of several.

    The peer is ahead by at least `low` (valid at local time `low_at`), and by at most `high` (valid at `high_at`)."""

    low_at: float
    low: float
    high_at: float
    high: float

    def merged(self, other: _Edges, rates: tuple[float, float]) -> _Edges:
        """Return the tighter bound on each side; which one is tighter does not depend on the time."""
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
    """Estimate of one peer's clock: the best bounds of every SLOT seconds, and the rates that they allow.

    `fleet` is the peer's fleet time minus its local time, as last reported, no earlier than at local time `said`."""

    def __init__(self) -> None:
        self.fleet: float | None = None
        self.said = -inf
        self.rates = (-DRIFT, DRIFT)  # bounds of the peer's rate minus this clock's rate
        self._slots: deque[_Edges] = deque(maxlen=SLOTS)
        self._number = 0.0  # number of the last slot
        self._best: _Edges | None = None
        self._odd: _PeerClock | None = None

    def limits(self, now: float) -> tuple[float, float]:
        """Return bounds of the time by which the peer's clock is ahead of this one."""
        return (-inf, inf) if self._best is None else self._best.on(now, self.rates)

    def take(self, edges: _Edges, fleet: float | None) -> _PeerClock:
        """Add an exchange. Return the estimate to use from now on.

        A new estimate begins when two successive exchanges agree with each other but not with the old one: one of the
        machines was suspended, or the peer's was restarted."""
        if self._add(edges, fleet):
            self._odd = None
            return self
        if self._odd is None or not self._odd._add(edges, fleet):
            self._odd = _PeerClock()
            self._odd._add(edges, fleet)
            return self
        return self._odd

    def _add(self, edges: _Edges, fleet: float | None) -> bool:
        """Add an exchange. Return False, without a change, if it contradicts the estimate."""
        now = edges.low_at
        best = edges if self._best is None else self._best.merged(edges, self.rates)
        low, high = best.on(now, self.rates)
        if low > high or (fleet is not None and self.fleet is not None and abs(fleet - self.fleet) > STEP):
            return False
        if fleet is not None and edges.high_at >= self.said:
            self.fleet, self.said = fleet, edges.high_at
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
        """Estimate the rates from bounds of older and newer slots, and the best bounds under these rates."""
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
        ):  # the rate has changed by more than WANDER: only the newest bounds are valid
            self.rates = (-DRIFT, DRIFT)
            self._slots = deque(slots[-1:], maxlen=SLOTS)
            self._best = slots[-1]


class FleetClock:
    """Fleet time on robot `pid`.

    Before `lock` it steps to the best estimate. Afterwards it slews and never goes back; only a lag above STEP is
    corrected at once.

    Robot 0 is the first reference, and fleet time its local time. A robot that becomes the reference continues its own
    estimate at the rate of its own clock. The others follow it, and `bound` refers to its fleet time."""

    def __init__(self, pid: int) -> None:
        self.reference = 0
        self.breaks = 0  # number of times that the reference's clock, or this one, changed its origin
        self._pid = pid
        self._exchanges: dict[int, _PeerClock] = {}
        self._known = pid == self.reference
        self._followed = -inf
        self._offset = 0.0
        self._locked = False
        self._estimated = -inf  # time when the estimate was last computed and reached
        self._last = -inf

    @property
    def known(self) -> bool:
        """True if there is an estimate."""
        return self._known

    @property
    def drift(self) -> float:
        """The reference's rate minus this clock's rate, as a share of it."""
        peer = self._exchanges.get(self.reference)
        return 0.0 if peer is None or self.reference == self._pid else sum(peer.rates) / 2

    def bound(self, now: float) -> float:
        """Return a bound of the error of fleet time at local time `now` (s).

        Inf without data of the reference.

        It does not foresee a suspended machine; two exchanges later it is right again."""
        if self.reference == self._pid:
            return 0.0
        estimate = self._estimate(now)
        return inf if estimate is None else estimate[1] + abs(estimate[0] - self._offset)

    def offset(self, now: float) -> float | None:
        """Return fleet time minus local time (s), for messages to others; None if unknown."""
        if not 0.0 <= now - self._estimated < FRESH or now < self._last:
            self.read(now)
        else:
            self._last = now
        return self._offset if self._known else None

    def follow(self, reference: int, now: float) -> None:
        """Follow another reference robot from now on. Earlier exchanges with it count."""
        if reference == self.reference:
            return
        self.read(now)
        if self.reference == self._pid and not self._locked:
            self._known = False  # no other robot has used this robot's fleet time yet
        self.reference = reference
        self._followed = now
        self._estimated = -inf
        self._known = self._known or reference == self._pid or self._estimate(now) is not None

    def take(self, peer: int, sent: float, received: float, answered: float, now: float, fleet: float | None) -> bool:
        """Add an exchange with a peer. Return False for stamps that no honest exchange yields.

        `sent` and `now` (back) are times of the local clock, `received` and `answered` of the peer's; `fleet` is the
        peer's `offset`."""
        edges = _Edges(now, answered - now - ROUNDING, sent, received - sent + ROUNDING)
        low, high = edges.on(now, (-DRIFT, DRIFT))
        if not (peer != self._pid and sent <= now and received <= answered and low <= high):
            return False
        before = self._exchanges.get(peer) or _PeerClock()
        after = self._exchanges[peer] = before.take(edges, fleet)
        self._estimated = -inf
        if peer == self.reference:
            self.breaks += after is not before
            self._known = self._known or after.fleet is not None
        return True

    def lock(self) -> None:
        """Forbid steps back: the mission's start is fixed."""
        self._locked = True

    def read(self, now: float) -> float:
        """Return the fleet time at local time `now`. Once locked, it never decreases unless `now` does."""
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
                    self._estimated = -inf  # the rest is corrected by later calls
            self._offset += wanted
        self._last = max(self._last, now)
        return now + self._offset

    def local(self, fleet: float) -> float:
        """Return the local time at which fleet time will be `fleet`, by the present estimate."""
        return fleet - self._offset

    def _estimate(self, now: float) -> tuple[float, float] | None:
        """Return fleet time minus local time as the reference reported it, and a bound of its error."""
        peer = self._exchanges.get(self.reference)
        if peer is None or peer.fleet is None or self.reference == self._pid:
            return None
        low, high = peer.limits(now)
        # the peer itself still followed another reference
        moved = SLEW * max(0.0, now - peer.said) if peer.said < self._followed else 0.0
        return peer.fleet + (low + high) / 2, (high - low) / 2 + moved
