"""Squads in lockstep: the agent of a squad runs in the agent of one of its robots, and moves to another one."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from koordgen.runtime.trace.writer import Trace
from targets.sim.base.scenario import Robot
from targets.sim.lockstep.time_shares import TimeShares
from targets.sim.lockstep.traced import TracedAgent, TraceFile
from targets.sim.run.run_interface import AgentHandle


class LockstepSquad(TracedAgent):
    """Agent handle of a squad. It lives while one of its robots does: end or crash its robots to end it.

    All robots that host the squad's agent, one after another, write into the same trace and log."""

    def __init__(self, robot: Robot, folder: Path, delta: float, shares: TimeShares) -> None:
        super().__init__(robot, folder, delta)
        self._members: Sequence[AgentHandle] = ()
        self._out = TraceFile(self.trace_file.open("ab"), shares)

    def consist_of(self, members: Sequence[AgentHandle]) -> None:
        """Set the robots of the squad."""
        self._members = members

    def trace(self) -> Trace:
        """Return a new trace for a host."""
        assert self._out is not None
        return Trace(_KeptOpen(self._out), self._warn)  # type: ignore[arg-type]

    def emit(self, level: str, line: str) -> None:
        """Write a line of the squad's agent into its log."""
        self._emit(level, line)

    @property
    def alive(self) -> bool:
        return any(member.alive for member in self._members)

    @property
    def status(self) -> int | None:
        """0 once all robots of the squad have ended normally; otherwise None: failures are those of its robots."""
        return 0 if all(member.status == 0 for member in self._members) else None

    def request_end(self) -> None:
        self.asked_to_end = True

    def kill(self) -> None:
        """Do nothing: the run kills each robot of the squad."""

    def crash(self) -> None:
        """Do nothing: no fault names a squad."""

    def restart(self) -> None:
        """Do nothing: no fault names a squad."""

    def freeze(self, seconds: float) -> None:
        """Do nothing: no fault names a squad."""

    @property
    def frozen(self) -> bool:
        return False

    def thaw(self) -> None:
        """Do nothing: no fault names a squad."""

    def _failed(self, status: int) -> str | None:
        return None

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
