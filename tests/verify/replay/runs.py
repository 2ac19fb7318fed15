"""Traces of fleets that ran in this process, with the program beside them as in a run's folder."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.fixtures.fleet import NAMES, FakePlatform, Fleet
from koordgen.build.emit.program import program_hash, program_text
from koordgen.build.pipeline import check_file
from koordgen.lang.analyze.params import with_params
from koordgen.lang.ir.decl import Program
from koordgen.runtime.config.settings import Safety
from koordgen.runtime.net.network import Conditions
from koordgen.runtime.trace import schema
from koordgen.runtime.trace.schema import End, Header, RobotName
from targets.sim.trace import files as trace
from tests.build.emit.generated import _module

EXAMPLES = Path(__file__).parents[3] / "examples"


class Run:
    """A program of its text, or an example's; `folder` is as `koordgen sim` leaves it. Traces of a robot that began
    anew go on in the same file."""

    def __init__(
        self, folder: Path, text: str, n: int = 3, seed: int = 1, conditions: Conditions | None = None,
        params: dict[str, Any] | None = None, functions: str = "", platform: type[FakePlatform] = FakePlatform,
    ) -> None:  # fmt: skip
        self.folder, self.n = folder, n
        source = folder / "source"
        source.mkdir(parents=True)
        (source / "app.koord").write_text(text)
        (source / "params.json").write_text(json.dumps(params or {}))
        if functions:
            (source / "app_functions.py").write_text(functions)
        self.program: Program = with_params(check_file(str(source / "app.koord")).program, params or {})
        self.hash = program_hash(self.program, functions.encode())
        built = _module("program", program_text(self.program, functions.encode())).PROGRAM
        if functions:
            built.library._module = _module("app_functions", functions)
        self.fleet = Fleet(n, seed, conditions, built, clocks=lambda pid, base: base, safety=Safety(peer_timeout=8))
        self.files: dict[int, list[Any]] = {pid: [] for pid in range(n)}
        self.platform = platform
        for pid in range(n):
            self.boot(pid)

    def boot(self, pid: int) -> None:
        body = self.fleet.robots[pid].platform if pid in self.fleet.robots else self.platform(_start(pid))
        self.files[pid].append(self.fleet.boot(pid, body).file)

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> Run:
        self.fleet.run(seconds, until)
        return self

    def save(self) -> Path:
        """The folder, with each robot's trace and the merged one."""
        robots = tuple(RobotName(NAMES[pid], pid, "fake") for pid in range(self.n))
        save_traces(
            self.folder,
            Header(schema.FORMAT, "app", self.hash, self.fleet.delta, 0, robots),
            self.files,
            self.fleet.time.time,
        )
        return self.folder


def save_traces(folder: Path, header: Header, files: dict[int, list[Any]], end: float) -> None:
    """Write each robot's trace, and the merged one, as a run leaves them. `files`: those of each start of a robot."""
    own = []
    for robot in header.robots:
        path = folder / "robots" / robot.name / "trace.jsonl"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"".join(file.getvalue() for file in files[robot.pid]))
        own.append(path)
    poses = folder / "poses.jsonl"
    poses.write_bytes(b"")
    trace.merge(folder / "trace.jsonl", header, 0.0, poses, own, [End(end, "completed")])


def _start(pid: int) -> Any:
    from koordgen.runtime.values.points import Point

    return Point(2.0 * pid, 0.0, 0.0)


def example(folder: Path, name: str, **options: Any) -> Run:
    """One of the examples, which needs no functions."""
    return Run(folder, (EXAMPLES / name / f"{name}.koord").read_text(), **options)
