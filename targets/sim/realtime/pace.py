"""The pace of the world: which physics steps are due at a host time, on absolute ticks. Pure."""

from __future__ import annotations

BURST = 24  # steps at once when behind; then others get their turn
MOST_BEHIND = 0.25  # seconds; a world that is further behind lets its clock stand still for the rest


class Pace:
    """Step k is due at start + k * step (host seconds) + `slip`, the time that the world stood still. `late` counts
    steps that began more than one step after they were due. With `most_behind` infinite the world never stands still:
    it makes up for all that it is behind."""

    def __init__(self, start: float, step: float, most_behind: float = MOST_BEHIND) -> None:
        self._step = step
        self._start = start
        self._most_behind = most_behind
        self.done = 0
        self.late = 0
        self.slip = 0.0

    def due(self, now: float) -> int:
        """How many steps to make at host time `now`, at most BURST; they count as done."""
        behind = now - self.tick(self.done)
        if behind > self._most_behind:
            self.slip += behind - self._most_behind
        number = int((now - self.tick(self.done)) // self._step) + 1
        number = max(0, min(BURST, number))
        self.late += sum(now - self.tick(k) > self._step for k in range(self.done, self.done + number))
        self.done += number
        return number

    def tick(self, step: int) -> float:
        """The host time at which a step is due."""
        return self._start + step * self._step + self.slip

    def factor(self, now: float) -> float:
        """World seconds per host second since the start."""
        return self.done * self._step / (now - self._start) if now > self._start else 1.0
