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

    All robots that host the squad's agent write into the same log, and each into a part of the trace."""

    def __init__(self, robot: Robot, folder: Path, delta: float, shares: TimeShares) -> None:
        super().__init__(robot, folder, delta)
        self._shares = shares
        self._parts: list[TraceFile] = []

    def trace(self) -> Trace:
        """Return a new trace for a host."""
        self._parts.append(TraceFile(self._part(len(self._parts)).open("wb"), self._shares))
        return Trace(self._parts[-1], self._warn)  # type: ignore[arg-type]

    def _part(self, number: int) -> Path:
        return self.trace_file.with_name(f"{self.trace_file.stem}-{number}.jsonl")

    def emit(self, level: str, line: str) -> None:
        """Write a line of the squad's agent into its log."""
        self._emit(level, line)

    def _read(self) -> None:
        for part in self._parts:
            self._receive(part)

    def close(self) -> None:
        """Close the files, and join the parts of the trace. Idempotent."""
        with suppress(OSError):
            self._log.close()
            self._read()
            with self.trace_file.open("ab") as whole:
                for number, part in enumerate(self._parts):
                    part.close()
                    whole.write(self._part(number).read_bytes())
                    self._part(number).unlink()
            self._parts = []
