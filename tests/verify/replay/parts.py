"""Fleets whose robots write their traces in parts, as on real computers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from benchmarks.fixtures.fleet import NAMES
from koordgen.runtime.trace.parts import TraceFileParts
from tests.verify.replay.runs import Run, _start


class Kept(Run):
    """As a Run; `limit`: bytes of each robot's parts, in `home/<name>/`."""

    def __init__(self, folder: Path, text: str, limit: int, home: Path | None = None, **options: Any) -> None:
        self.limit, self.home = limit, home or folder / "robots"
        super().__init__(folder, text, **options)

    def boot(self, pid: int) -> None:
        earlier = self.fleet.robots.get(pid)
        body = earlier.platform if earlier is not None else self.platform(_start(pid))
        if earlier is not None:
            earlier.agent._journal._trace.close()
        folder = self.home / NAMES[pid]
        folder.mkdir(parents=True, exist_ok=True)
        self.fleet.boot(pid, body, output=TraceFileParts(folder / "trace.jsonl", NAMES[pid], self.limit))

    def save(self) -> Path:
        for robot in self.fleet.robots.values():
            robot.agent._journal._trace.close()
        return self.folder
