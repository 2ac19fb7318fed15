"""Agent handles of agents in this process, which trace into memory and into a file."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import IO

from koordgen.runtime.trace.schema import HEADER, TraceRecord, decoded
from targets.sim.base.scenario import Robot
from targets.sim.lockstep.time_shares import TimeShares
from targets.sim.run.run_interface import AgentHandle


class TraceFile:
    """Trace file that also keeps the lines written since they were last read."""

    def __init__(self, file: IO[bytes], shares: TimeShares) -> None:
        self._file, self._shares = file, shares
        self.lines: list[bytes] = []

    def write(self, line: bytes) -> None:
        """Raises OSError."""
        began = self._shares.begin()
        self._file.write(line)
        self.lines.append(line)
        self._shares.end("trace", began)

    def flush(self) -> None:
        """Do nothing: nobody reads the file before the run's end."""

    def close(self) -> None:
        self._file.close()


class TracedAgent(AgentHandle):
    """Agent handle with the log of an agent in this process, and with the records that it has traced."""

    def __init__(self, robot: Robot, folder: Path, delta: float) -> None:
        super().__init__(robot, folder, delta)
        self._log: IO[str] = self.log_file.open("w", encoding="utf-8")
        self._out: TraceFile | None = None  # the trace's file
        self._seen: list[TraceRecord] = []  # since `look` was last called

    def look(self) -> list[TraceRecord]:
        self._read()
        records, self._seen = self._seen, []
        return records

    def _read(self) -> None:
        """Read the records traced since the last call."""
        if self._out is not None:
            self._receive(self._out)

    def _receive(self, file: TraceFile) -> None:
        """Read the records written to one file since the last call."""
        lines, file.lines = file.lines, []
        for line in lines:
            if not line.startswith(HEADER):  # an agent's own header differs from that of the merged trace
                record = decoded(line)
                if record is not None:
                    self._record(record)
                    self._seen.append(record)

    def _emit(self, level: str, line: str) -> None:
        with suppress(OSError):  # a full disk
            self._log.write(line + "\n")

    def _warn(self, text: str) -> None:
        self._emit("warning", f"warning: {text}")

    def note(self, line: str) -> None:
        """Write a line between the agent's own lines. See AgentHandle."""
        self._emit("warning", line)

    def last_lines(self, count: int) -> list[str]:
        with suppress(OSError):
            self._log.flush()
        return super().last_lines(count)
