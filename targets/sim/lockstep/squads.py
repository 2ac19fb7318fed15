"""Squads in lockstep: the agent of a squad runs in the agent of one of its robots, and moves to another one."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from koordgen.runtime.trace.writer import Trace
from targets.sim.base.scenario import Robot
from targets.sim.lockstep.time_shares import TimeShares
from targets.sim.lockstep.traced import TracedAgent, TraceFile
from targets.sim.run.squad_handle import SquadHandle


class LockstepSquad(SquadHandle, TracedAgent):
    """Agent handle of a squad in lockstep.

    All robots that host the squad's agent, one after another, write into the same trace and log."""

    def __init__(self, robot: Robot, folder: Path, delta: float, shares: TimeShares) -> None:
        super().__init__(robot, folder, delta)
        self._out = TraceFile(self.trace_file.open("ab"), shares)

    def trace(self) -> Trace:
        """Return a new trace for a host."""
        assert self._out is not None
        return Trace(_KeptOpen(self._out), self._warn)  # type: ignore[arg-type]

    def emit(self, level: str, line: str) -> None:
        """Write a line of the squad's agent into its log."""
        self._emit(level, line)

    def close(self) -> None:
        """Close the files. Idempotent."""
        with suppress(OSError):
            self._log.close()
            if self._out is not None:
                self._read()
                self._out.close()
                self._out = None


class _KeptOpen:
    """Trace file of a squad that stays open when one of its hosts closes it."""

    def __init__(self, file: TraceFile) -> None:
        self._file = file

    def write(self, line: bytes) -> None:
        """Raises OSError."""
        self._file.write(line)

    def flush(self) -> None:
        self._file.flush()

    def close(self) -> None:
        """Do nothing. See LockstepSquad.close."""
