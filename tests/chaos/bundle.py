"""Programs of the chaos tests, compiled by koordgen: what is tested is what flies."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
PROGRAMS = Path(__file__).with_name("programs")
NAMES = ("alice", "bert", "cleo", "dora", "emil")
KEY = bytes(range(32))


def build(program: str, folder: Path, n: int = 5, **params: int) -> Path:
    """The bundle of robot 0; the others' differ in their settings only. Built anew unless it is there."""
    out = folder / "-".join([program, *(f"{k}{v}" for k, v in params.items())])
    bundle = out / program / NAMES[0]
    if bundle.exists():
        return bundle
    out.mkdir(parents=True)
    robots = "".join(f"  - {{name: {NAMES[i]}, target: car, address: '127.0.0.1:{47100 + i}'}}\n" for i in range(n))
    fleet = out / "fleet.yaml"
    fleet.write_text(
        "delta: 0.1\norigin: {latitude: 47.4, longitude: 8.5, altitude: 400.0}\n"
        f"geofence: {{lo: [-5, -5, -1], hi: [5, 5, 4]}}\nrobots:\n{robots}"
    )
    source = PROGRAMS / f"{program}.koord"
    given = [text for name, value in params.items() for text in ("--param", f"{name}={value}")]
    command = [sys.executable, "-m", "koordgen", "build", str(source), "--target", "car", "--fleet", str(fleet)]
    subprocess.run([*command, "-o", str(out), *given], cwd=ROOT, check=True, capture_output=True)
    return bundle
