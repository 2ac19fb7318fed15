"""Hand-made windows of runs, as a simulator writes them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from koordgen.experiment.validate.samples import FILE, FORMAT, RunSample, read

PLATFORMS = ("quad full", "car full")


def window(round_: int, pid: int, came: str, out: Sequence[float] = (), far: float = 0.5) -> dict[str, Any]:
    """One, of a robot that flies east to a target 5 m away at 1 m/s."""
    row: dict[str, Any] = {
        "round": round_, "pid": pid, "came": came, "start": [0, 0, 1], "target": [5, 0, 1], "velocity": [1, 0, 0],
        "reach": 5.0,
    }  # fmt: skip
    return row | {"out": list(out), "then": [1, 0, 0], "far": far} if out else row


def text(rows: Sequence[dict[str, Any]], ended: str = "completed", seed: int = 1, lines: Sequence[int] = (8,)) -> str:
    """A whole file."""
    head = {
        "format": FORMAT, "app": "app", "program_hash": "0", "seed": seed, "delta": 0.1, "body": "Motion",
        "robots": [{"name": f"robot{k}", "platform": platform} for k, platform in enumerate(PLATFORMS)],
        "assumptions": [{"module": "Motion", "line": line} for line in lines], "unchecked": [],
    }  # fmt: skip
    return "".join(json.dumps(row) + "\n" for row in [head, *rows, {"end": ended}])


def sample(folder: Path, rows: Sequence[dict[str, Any]], run: int = 0, **more: Any) -> RunSample:
    """Written and read."""
    (folder / FILE).write_text(text(rows, seed=run + 1, **more))
    found = read(folder, run)
    assert found is not None
    return found


def held(folder: Path, run: int = 0) -> RunSample:
    """Nothing happened to either robot in two windows."""
    return sample(folder, [window(r, pid, "h") for r in (1, 2) for pid in (0, 1)], run)
