"""How much of the processor's time something may take that must not be in the way: a share of what all else takes."""

from __future__ import annotations

from collections.abc import Callable

MOST = 0.001  # seconds that can be saved up

Cpu = Callable[[], float]  # seconds of the processor's time that this thread has had


class Allowance:
    """`begin` and `end` stand around what is paid for. Without a `cpu` there is no bound, as in a simulation, where
    what a robot does must not depend on the computer."""

    def __init__(self, cpu: Cpu | None, share: float) -> None:
        self._cpu, self._share = cpu, share
        self._left = 0.0
        self._began = self._ended = 0.0 if cpu is None else cpu()

    def begin(self) -> bool:
        """Whether something is left. Who does nothing then need not say `end`."""
        if self._cpu is None:
            return True
        self._began = self._cpu()
        self._left = min(MOST, self._left + self._share * (self._began - self._ended))
        self._ended = self._began
        return self._left > 0.0

    @property
    def spent(self) -> bool:
        """Whether nothing is left."""
        return self._cpu is not None and self._cpu() - self._began >= self._left

    def end(self) -> None:
        if self._cpu is not None:
            self._ended = self._cpu()
            self._left -= self._ended - self._began
