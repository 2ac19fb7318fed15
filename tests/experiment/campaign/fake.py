"""Fake bundle that replaces a simulator: it does at once what its options say, and writes a run's files."""

from __future__ import annotations

import errno
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import pytest

from koordgen.experiment.campaign import store

NAME = "sim"
SOURCE = """
import argparse, json, os, sys, time
from pathlib import Path

p = argparse.ArgumentParser()
p.add_argument("--duration", type=float, default=30.0)
p.add_argument("--seed", type=int, default=0)
p.add_argument("--loss", type=float, default=0.0)
p.add_argument("--mode", default="held", choices=["held", "violated", "crash", "silent", "hang", "once"])
p.add_argument("--out", type=Path)
p.add_argument("--settings", type=Path)
p.add_argument("--invoked-as")
p.add_argument("--lockstep", action="store_true")
p.add_argument("--scenario", type=Path)
p.add_argument("--no-report", action="store_true")
p.add_argument("--quiet", action="store_true")
p.add_argument("--check", action="store_true")
o = p.parse_args()
if o.check:
    sys.exit(0)
o.out.mkdir(parents=True)  # only a folder of nothing is free
(o.out / "began").write_text(o.invoked_as)
if not o.no_report:
    (o.out / "report.html").touch()
if o.mode == "hang" or (o.mode == "once" and not Path("again").exists()):
    Path("hangs").touch()
    time.sleep(60)
if o.mode == "crash":
    print("error: no world\\\\n  help: none", file=sys.stderr)
    sys.exit(5)
if o.mode == "silent":
    sys.exit(3)
bad = o.mode == "violated" or o.loss > 0.2
settings = json.loads(o.settings.read_text()) if o.settings else {}
why = "at 1.50 s alice and bert: separation, 0.2 m apart"
(o.out / "summary.json").write_text(json.dumps({
    "verdict": "violated" if bad else "held", "why": why if bad else "all robots ended by themselves",
    "violations": [{"t": 1.5, "what": "separation", "robots": ["alice", "bert"], "detail": ""}] if bad else [],
    "duration": 10.0 + o.seed + EXTRA, "min_separation": {"distance": 1.0 - o.loss}, "settings": settings,
    "scenario": json.loads(o.scenario.read_text()) if o.scenario else None,
    "robots": [{"late_rounds": 2}, {"late_rounds": 1}],
}))
sys.exit(3 if bad else 0)
"""


def build(params: Mapping[str, str], folder: Path) -> None:
    """Writes the bundle; the param `extra` makes missions longer."""
    own = folder / NAME
    own.mkdir(parents=True)
    (own / "__main__.py").write_text(SOURCE.replace("EXTRA", params.get("extra", "0")), encoding="utf-8")


@contextmanager
def full_disk(finished: int) -> Iterator[None]:
    """A disk that is full once so many runs are finished."""
    real = store.CampaignStore.add

    def add(self: store.CampaignStore, result: store.RunResult) -> None:
        if len(self.results) == finished:
            raise OSError(errno.ENOSPC, "No space left on device")
        real(self, result)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(store.CampaignStore, "add", add)
        yield
