"""Squads in real time: the agent of a squad runs in the process of one of its robots.

Each of these processes has settings for it, `outer.json`, and a trace of it, `outer.jsonl`, in its folder."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO

from koordgen.runtime.trace.parts import numbered
from koordgen.runtime.trace.schema import TraceRecord
from targets.sim.base.scenario import Robot
from targets.sim.run.squad_handle import SquadHandle
from targets.sim.trace.files import records_in

SETTINGS, TRACE = "outer.json", "outer.jsonl"


class SetAsideTail:
    """Incremental reader of a trace that is set aside when its agent is started again in the same process."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: IO[bytes] | None = None
        self._incomplete = b""

    def read(self) -> list[TraceRecord]:
        """Return the records written since the last call."""
        found = self._new_records()
        if self._is_replaced():
            found += self._new_records()
            self.close()
            with suppress(FileNotFoundError):
                self._file = self._path.open("rb")
            found += self._new_records()
        return found

    def _is_replaced(self) -> bool:
        """Return whether another file is at the path than the open one."""
        try:
            return self._file is None or os.fstat(self._file.fileno()).st_ino != self._path.stat().st_ino
        except FileNotFoundError:
            return False

    def _new_records(self) -> list[TraceRecord]:
        if self._file is None:
            return []
        *lines, self._incomplete = (self._incomplete + self._file.read()).split(b"\n")
        return records_in(lines)[0]

    def close(self) -> None:
        if self._file is not None:
            self._file.close()
        self._file, self._incomplete = None, b""


class RealTimeSquad(SquadHandle):
    """Agent handle of a squad in real time. `places`: the folders of its robots."""

    def __init__(self, robot: Robot, folder: Path, delta: float, places: Sequence[Path]) -> None:
        super().__init__(robot, folder, delta)
        self._traces = [place / TRACE for place in places]
        self._tails = [SetAsideTail(path) for path in self._traces]

    def look(self) -> list[TraceRecord]:
        records = [record for tail in self._tails for record in tail.read()]
        for record in records:
            self._record(record)
        return records

    def close(self) -> None:
        """Join the traces of all hosts. Idempotent."""
        for tail in self._tails:
            tail.close()
        with self.trace_file.open("ab") as whole:
            for trace in self._traces:
                for part in [*[part for _, part in numbered(trace)], trace]:
                    if part.exists():
                        written = part.read_bytes()
                        whole.write(written if written.endswith(b"\n") else written + b"\n")  # it was cut off
                        part.unlink()
