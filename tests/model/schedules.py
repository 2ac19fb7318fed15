"""Random schedules of the real shared state: delay, reordering, repetition, loss, partition, crash and restart; then a
time without any of it, in which all must come together again."""

from __future__ import annotations

from random import Random

from tests.model.lab import Fleet, Violation

STEP = 0.2  # rounds between two moments
HEAL = 30  # rounds without trouble after which all must agree
QUIET = 6  # of them, the last, without events
WISHES = ("", "plain", "plain", "quiet", "atomic", "atomic")


class Schedule:
    def __init__(self, seed: int, rounds: int = 12, n: int = 3, crashes: int = 1) -> None:
        self.random = Random(seed)
        self.rounds = rounds
        self.fleet = Fleet(n, self._wish)
        self.loss = self.random.choice((0.0, 0.1, 0.3))
        self.delay = self.random.choice((1.0, 0.7, 0.3))  # the chance that what is in flight arrives at a moment
        self.again = self.random.choice((0.0, 0.1))
        self.quiet = False
        self.cut: set[frozenset[int]] = set()
        self.down: dict[int, float] = {}
        self.crashes = crashes
        self.skew = [self.random.random() * 0.3 for _ in range(n)]

    def _wish(self, pid: int) -> str:
        return "" if self.quiet else self.random.choice(WISHES)

    def run(self) -> Fleet:
        """Raises Violation."""
        random, fleet, now = self.random, self.fleet, 0.0
        while now < self.rounds:
            now += STEP
            if random.random() < 0.03:
                pids = range(fleet.n)
                self.cut = {frozenset((a, b)) for a in pids for b in pids if a < b and random.random() < 0.4}
            if self.crashes and random.random() < 0.02:
                self.crashes -= 1
                self.down[random.randrange(fleet.n)] = now + random.choice((0.0, 0.2, 1.0, 4.0))
            self._moment(now)
        self.loss, self.delay, self.again, self.cut = 0.0, 1.0, 0.0, set()
        for pid in self.down:
            fleet.restart(pid)
        self.down = {}
        while now < self.rounds + HEAL:
            now += STEP
            self.quiet = now > self.rounds + HEAL - QUIET
            self._moment(now)
        self._together()
        return fleet

    def _moment(self, now: float) -> None:
        random, fleet = self.random, self.fleet
        for pid, until in list(self.down.items()):
            if now >= until:
                del self.down[pid]
                fleet.restart(pid)
        for _ in range(3):
            order = list(range(fleet.n))
            random.shuffle(order)
            for pid in order:
                if pid not in self.down:
                    self._hear(pid)
                    if random.random() < 0.8:
                        fleet.poll(pid, now + self.skew[pid])

    def _hear(self, pid: int) -> None:
        random, fleet = self.random, self.fleet
        arrived = fleet.take(lambda f: f.to == pid and random.random() < self.delay)
        if self.delay < 1:
            random.shuffle(arrived)
        for flight in arrived:
            if frozenset((pid, flight.message.head.pid)) in self.cut or random.random() < self.loss:
                continue
            fleet.deliver(flight)
            if random.random() < self.again:
                fleet.flights.append(flight)

    def _together(self) -> None:
        robots = self.fleet.robots
        states = [r.state for r in robots]
        if None in states:
            out = [p for p, m in enumerate(states) if m is None]
            raise Violation(f"P7: after {HEAL} rounds robots {out} are out: {[r.replica.views.view for r in robots]}")
        for pid, robot in enumerate(robots):
            state = robot.state
            assert state is not None
            if state.applied < self.rounds + HEAL - 2:
                raise Violation(f"P7: robot {pid} has applied only {state.applied}")
            if state.shared["mine"][pid] != robot.program.locals["events"]:
                raise Violation(f"P3: robot {pid} has {robot.program.locals}, the fleet {state.shared}")
            if state.shared["wins"][pid] != robot.program.locals["wins"]:
                raise Violation(f"P3: robot {pid} has {robot.program.locals}, the fleet {state.shared}")
