"""Counterexamples, and other runs, that agents follow in this process."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

from koordgen.cli import main
from koordgen.cli.commands import parsed
from targets.sim.harness import main as harness

FLEET = """\
delta: 0.05
origin: {latitude: 47.4, longitude: 8.5, altitude: 400.0}
geofence: {lo: [-9, -9, -1], hi: [90, 9, 9]}
sim: {fidelity: simple}
robots:
"""
DRIVER = """
class Dev:
    sensors = {"level": "int"}
    actuators = {}

    def sense(self):
        return {"level": 0}

    def command(self, values):
        pass
"""


class Followed(NamedTuple):
    """How a run ended, what it printed last, and its folder."""

    status: int
    said: str
    folder: Path


def fleet(folder: Path, n_sys: int, more: str = "", target: str = "car") -> Path:
    """A fleet file of so many robots; `more` comes before them."""
    robots = "".join(
        f"  - {{name: r{pid}, target: {target}, address: '127.0.0.1:{47900 + pid}', "
        f"start: {{position: [{3 * pid}, 0, 0]}}}}\n"
        for pid in range(n_sys)
    )
    path = folder / "fleet.yaml"
    path.write_text(more + FLEET + robots)
    return path


def follow(
    app: Path, fleet: Path, trace: Path, change: Callable[[Any], None] = lambda plan: None, out: str = "run",
    more: Sequence[str] = (),
) -> Followed:  # fmt: skip
    """As `koordgen sim --follow` does it, but in this process; `change` is done to the plan before."""
    arguments = [str(app), "--fleet", str(fleet), "--follow", str(trace), *more]
    return _followed(arguments, app.parent, change, out)


def follow_fleet(fleet: Path, trace: Path, out: str = "run") -> Followed:
    """As `koordgen sim fleet.yaml --follow` does it, but in this process."""
    return _followed([str(fleet), "--follow", str(trace)], fleet.parent, lambda plan: None, out)


def _followed(arguments: list[str], home: Path, change: Callable[[Any], None], out: str) -> Followed:
    from koordgen.cli.base import building, console
    from koordgen.cli.experiment.follow import plan_of_trace

    options = parsed(["sim", *arguments])
    try:
        params, plan = plan_of_trace(options)
    except console.Failure as failure:
        return Followed(failure.status, f"{failure} | {failure.help}", home)
    with redirect_stderr(StringIO()):  # warnings
        bundles, _ = building.planned(options, ["sim"], params)
    bundle = home / f"{out}-bundle"
    building.write({"sim": bundles["sim"]}, bundle)
    plan = json.loads(json.dumps(plan))
    change(plan)
    (bundle / "follow.json").write_text(json.dumps(plan))
    folder = home / out
    arguments = ["--follow", str(bundle / "follow.json"), "--out", str(folder), "--no-report", "--quiet"]
    with redirect_stdout(StringIO()) as told, redirect_stderr(StringIO()) as failed:
        status = harness(bundle / "sim", arguments)
    lines = (failed.getvalue() or told.getvalue()).strip().splitlines()
    return Followed(status, lines[0 if failed.getvalue() else -1], folder)


def replays(folder: Path) -> None:
    """`koordgen replay` finds no difference in a run, nor in any robot's own trace."""
    for trace in (folder / "trace.jsonl", *sorted(folder.glob("robots/*/trace.jsonl"))):
        with redirect_stdout(StringIO()), redirect_stderr(StringIO()) as failed:
            assert main(["replay", str(trace)]) == 0, failed.getvalue()
