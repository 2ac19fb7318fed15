"""Fake bundle that replaces a simulator and writes windows: the seed determines the outcome of a run."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from tests.experiment.validate.windows import text, window

NAME = "sim"
SOURCE = """
import argparse, json, os, sys, time
from pathlib import Path

p = argparse.ArgumentParser()
p.add_argument("--duration", type=float)
p.add_argument("--seed", type=int)
p.add_argument("--out", type=Path)
p.add_argument("--invoked-as")
for name in ("lockstep", "no-report", "quiet", "windows"):
    p.add_argument(f"--{name}", action="store_true", required=True)
o = p.parse_args()
o.out.mkdir(parents=True)
(o.out / "began").write_text(o.invoked_as)
if o.seed == 900 and not Path("again").exists():
    Path("hangs").touch()
    time.sleep(60)
if o.seed == 950:
    print("error: no world\\\\n  help: none", file=sys.stderr)
    sys.exit(5)
bad = o.seed >= 100 and o.seed % 2 == 1
(o.out / "windows.jsonl").write_text((BAD if bad else GOOD).replace('"seed": 1', f'"seed": {o.seed}'))
(o.out / "summary.json").write_text(json.dumps({"verdict": "violated" if bad else "held", "duration": o.duration}))
sys.exit(3 if bad else 0)
"""
LINE = 8


def build(params: Mapping[str, str], folder: Path) -> None:
    """Writes the bundle."""
    own = folder / NAME
    own.mkdir(parents=True)
    good = text([window(1, 0, "h"), window(1, 1, "h")], lines=(LINE,))
    bad = text([window(1, 0, "h"), window(1, 1, "v", (0.0, 0.04, 0.0), far=0.3)], lines=(LINE,))
    (own / "__main__.py").write_text(f"GOOD = {good!r}\nBAD = {bad!r}\n{SOURCE}", encoding="utf-8")
