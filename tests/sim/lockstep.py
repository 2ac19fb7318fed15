"""Sim bundles of the examples, run in lockstep, for tests."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from koordgen.cli import main

EXAMPLES = Path(__file__).parents[2] / "examples"


def built(folder: Path, app: str, fleet: str | None = None) -> Path:
    """The sim bundle of an example; `fleet` is YAML instead of the example's own."""
    source = EXAMPLES / app / f"{app}.koord"
    file = EXAMPLES / app / "fleet.yaml"
    if fleet is not None:
        file = folder / "fleet.yaml"
        file.write_text(fleet)
    arguments = ["build", str(source), "--fleet", str(file), "--target", "sim", "-o", str(folder / "build")]
    assert main(arguments) == 0
    return folder / "build" / app / "sim"


def ran(bundle: Path, out: Path, seconds: float, *more: str, hashing: str = "0") -> int:
    """Run a bundle in lockstep in a process of its own, with a PYTHONHASHSEED; its exit status."""
    command = [sys.executable, str(bundle), "--lockstep", "--duration", f"{seconds:g}", "--out", str(out), "--quiet"]
    environment = {"PYTHONHASHSEED": hashing, "OMP_NUM_THREADS": "1", "PATH": "/usr/bin:/bin", "HOME": str(out.parent)}
    done = subprocess.run([*command, *more], env=environment, capture_output=True, text=True, timeout=600)
    assert done.returncode in (0, 3), done.stdout + done.stderr
    return done.returncode


def summary(out: Path) -> Any:
    return json.loads((out / "summary.json").read_text())


def digest(out: Path) -> str:
    return hashlib.sha256((out / "trace.jsonl").read_bytes()).hexdigest()
