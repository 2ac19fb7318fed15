"""Progress of a run on a terminal: one line that is rewritten.

Without a terminal only problems are written."""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Sequence
from typing import TextIO

from targets.sim.run.run_interface import AgentHandle
from targets.sim.run.scene import SeparationMonitor

EVERY = 0.2  # seconds between two updates


class Progress:
    """Writer of progress to `stream` (standard error); with `quiet`, nothing is written.

    `free`: the run's clock is not the host's, so the factor is always shown."""

    def __init__(self, stream: TextIO, quiet: bool, free: bool = False) -> None:
        self._stream = stream
        self._quiet = quiet
        self._free = free
        self._live = stream.isatty()
        self._next = 0.0
        self._open = False  # the last line on the terminal will be rewritten

    def step(self, text: str) -> None:
        """Write a line about normal progress; only to a terminal."""
        if self._live:
            self.show_line(text)

    def show_line(self, text: str) -> None:
        """Write a line that is not overwritten."""
        if not self._quiet:
            self._write(("\r\x1b[K" if self._open else "") + text + "\n")
            self._open = False

    def show(
        self,
        now: float,
        zero: float | None,
        duration: float,
        agents: Sequence[AgentHandle],
        watch: SeparationMonitor,
        factor: float,
    ) -> None:
        """Show the present state if an update is due."""
        host = time.monotonic()
        if self._quiet or not self._live or host < self._next:
            return
        self._next = host + EVERY
        text = _starting(agents) if zero is None else _running(now - zero, duration, agents, watch)
        if self._free and zero is not None:
            text += f", {factor:.1f} times real time"
        elif zero is not None and factor < 0.98:
            text += f", the host is too slow: real-time factor {factor:.2f}"
        self._write("\r\x1b[K" + text[: max(20, shutil.get_terminal_size().columns - 1)])
        self._open = True

    def finish(self) -> None:
        """Erase the line that would be rewritten."""
        if self._open:
            self._write("\r\x1b[K")
            self._open = False

    def _write(self, text: str) -> None:
        try:
            self._stream.write(text)
            self._stream.flush()
        except OSError:  # the terminal is gone; the run continues
            self._quiet = True


def _starting(agents: Sequence[AgentHandle]) -> str:
    return " | ".join(f"{agent.robot.name} {agent.waiting_for()}" for agent in agents)


def _running(t: float, duration: float, agents: Sequence[AgentHandle], watch: SeparationMonitor) -> str:
    parts = [
        f"{min(t, duration):5.1f} of {duration:g} s",
        f"round {max(agent.round for agent in agents)}",
        f"{sum(agent.events for agent in agents)} events",
    ]
    if math.isfinite(watch.closest.distance):
        parts.append(f"closest {watch.closest.distance:.2f} m")
    gone = [agent.robot.name for agent in agents if not agent.alive]
    if gone:
        parts.append(f"ended: {', '.join(gone)}")
    return ", ".join(parts)
