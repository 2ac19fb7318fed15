"""Fleet clock: the time that the reference keeps, the lowest pid of the present view.

Local clocks are monotonic seconds of unknown origin, at most CRYSTAL off the true rate. An exchange with a peer (a
datagram out, and the echo of it back) has four stamps. As nothing arrives before it was sent, they hold the offset
between the two local clocks from both sides, however unequal the two delays are; the middle is off by half of the
shortest round trip at most. The peer says how far fleet time is from its local time, and that is constant for the
reference.
"""

from __future__ import annotations

from collections import deque
from functools import reduce
from math import copysign, inf
from typing import NamedTuple

CRYSTAL = 100e-6
DRIFT = 2 * CRYSTAL  # two of them, running apart
MOST_DRIFT = 500e-6  # no estimate goes beyond it
WANDER = 10e-6  # how far the present rate may be from the mean one of the last SLOTS * SLOT seconds
SLOT = 16.0  # seconds of which the best edges are kept
SLOTS = 32
APART = 5.0  # seconds between two edges that say something about the rate
ROUNDING = 2e-6  # stamps are whole microseconds
SLEW = 0.05  # the share of elapsed time by which a locked clock may be corrected: keeps it monotonic, no round jumps
FRESH = 0.02  # seconds for which an estimate is taken as it is: two clocks part by four microseconds at most
STEP = 0.1  # seconds: what would take longer than STEP / SLEW to make good is no error of an estimate


class _Edges(NamedTuple):
    """The peer's clock is ahead of ours by at least `low`, at local time `low_at`, and by at most `high`, at `high_at`:
    of an exchange, or the best of many."""

    low_at: float
    low: float
    high_at: float
    high: float

    def merged(self, other: _Edges, rates: tuple[float, float]) -> _Edges:
        """The better one on either side; which it is does not depend on the time."""
        low_at, low, high_at, high = self
        if other.low >= low + rates[0] * (other.low_at - low_at):
            low_at, low = other.low_at, other.low
        if other.high <= high + rates[1] * (other.high_at - high_at):
            high_at, high = other.high_at, other.high
        return _Edges(low_at, low, high_at, high)

    def on(self, now: float, rates: tuple[float, float]) -> tuple[float, float]:
        low_at, low, high_at, high = self
        return low + rates[0] * (now - low_at), high + rates[1] * (now - high_at)


class _Peer:
    """What exchanges tell of one peer's clock: the best edges of every SLOT seconds, and the rates they allow.

    `fleet` is the peer's fleet time less its local time, as it said last, no earlier than at our local time `said`.
    """

    def __init__(self) -> None:
        self.fleet: float | None = None
        self.said = -inf
        self.rates = (-DRIFT, DRIFT)  # the peer's rate less ours lies between
        self._slots: deque[_Edges] = deque(maxlen=SLOTS)
        self._number = 0.0  # of the last slot
        self._best: _Edges | None = None
        self._odd: _Peer | None = None

    def limits(self, now: float) -> tuple[float, float]:
        """The least and the most by which the peer's clock is ahead of ours."""
        return (-inf, inf) if self._best is None else self._best.on(now, self.rates)

    def take(self, edges: _Edges, fleet: float | None) -> _Peer:
        """The peer as it is known now. It begins anew when two exchanges in a row agree with each other and not with
        what was known: one of the two machines was suspended, or the peer's was restarted."""
        if self._add(edges, fleet):
            self._odd = None
            return self
        if self._odd is None or not self._odd._add(edges, fleet):
            self._odd = _Peer()
            self._odd._add(edges, fleet)
            return self
        return self._odd

    def _add(self, edges: _Edges, fleet: float | None) -> bool:
        """False, and nothing is changed, if it contradicts what is known."""
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
        """The rates, from edges of the older and of the newer slots, and what is the best edge by them."""
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
        ):  # the rate has changed by more than WANDER: only the newest edges tell of it
            self.rates = (-DRIFT, DRIFT)
            self._slots = deque(slots[-1:], maxlen=SLOTS)
            self._best = slots[-1]


class FleetClock:
    """Fleet time on robot `pid`. Until `lock` it steps to the best estimate; from then on it slews, and never goes
    back; only what it lags behind by more than STEP it makes good at once.

    Robot 0 is the reference at first, and fleet time its local time. A robot that becomes the reference goes on from
    its own estimate, at the rate of its own clock; the others follow it, and `bound` is about its fleet time.
    """

    def __init__(self, pid: int) -> None:
        self.reference = 0
        self.breaks = 0  # times that the reference's clock, or ours, turned out to have another origin than before
        self._pid = pid
        self._exchanges: dict[int, _Peer] = {}
        self._known = pid == self.reference
        self._followed = -inf
        self._offset = 0.0
        self._locked = False
        self._estimated = -inf  # when the estimate was last looked at, and was reached
        self._last = -inf

    @property
    def known(self) -> bool:
        """Whether there is an estimate at all."""
        return self._known

    @property
    def drift(self) -> float:
        """The reference's rate less ours, as a share of it."""
        peer = self._exchanges.get(self.reference)
        return 0.0 if peer is None or self.reference == self._pid else sum(peer.rates) / 2

    def bound(self, now: float) -> float:
        """How far fleet time may be off at local time `now`, in seconds; infinite as long as nothing was heard of the
        reference. It does not foresee that a machine is suspended: two exchanges later it is right again."""
        if self.reference == self._pid:
            return 0.0
        estimate = self._estimate(now)
        return inf if estimate is None else estimate[1] + abs(estimate[0] - self._offset)

    def offset(self, now: float) -> float | None:
        """Seconds to be added to the local clock for fleet time, for others to know; None while nothing is known."""
        if not 0.0 <= now - self._estimated < FRESH or now < self._last:
            self.read(now)
        else:
            self._last = now
        return self._offset if self._known else None

    def follow(self, reference: int, now: float) -> None:
        """From now on the fleet's time is this robot's. Exchanges with it from before count."""
        if reference == self.reference:
            return
        self.read(now)
        if self.reference == self._pid and not self._locked:
            self._known = False  # it was nobody's time but ours
        self.reference = reference
        self._followed = now
        self._estimated = -inf
        self._known = self._known or reference == self._pid or self._estimate(now) is not None

    def take(self, peer: int, sent: float, received: float, answered: float, now: float, fleet: float | None) -> bool:
        """Learn from an exchange with a peer: sent and back (`now`) by the local clock, received and answered by the
        peer's; `fleet` is the peer's `offset`. False for stamps that no honest exchange yields."""
        edges = _Edges(now, answered - now - ROUNDING, sent, received - sent + ROUNDING)
        low, high = edges.on(now, (-DRIFT, DRIFT))
        if not (peer != self._pid and sent <= now and received <= answered and low <= high):
            return False
        before = self._exchanges.get(peer) or _Peer()
        after = self._exchanges[peer] = before.take(edges, fleet)
        self._estimated = -inf
        if peer == self.reference:
            self.breaks += after is not before
            self._known = self._known or after.fleet is not None
        return True

    def lock(self) -> None:
        """The mission's start is fixed: no more steps back."""
        self._locked = True

    def read(self, now: float) -> float:
        """Fleet time at local time `now`; never decreases once locked, as long as `now` does not."""
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
                    self._estimated = -inf  # what is not reached yet is made good from one reading to the next
            self._offset += wanted
        self._last = max(self._last, now)
        return now + self._offset

    def local(self, fleet: float) -> float:
        """The local time at which fleet time will be `fleet`, as far as is known now."""
        return fleet - self._offset

    def _estimate(self, now: float) -> tuple[float, float] | None:
        """Fleet time less local time by what the reference said, and how far off that may be."""
        peer = self._exchanges.get(self.reference)
        if peer is None or peer.fleet is None or self.reference == self._pid:
            return None
        low, high = peer.limits(now)
        moved = SLEW * max(0.0, now - peer.said) if peer.said < self._followed else 0.0  # while it still followed
        return peer.fleet + (low + high) / 2, (high - low) / 2 + moved
