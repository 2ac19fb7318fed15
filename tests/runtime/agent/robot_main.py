"""A bundle's `__main__` for the process tests: LineForm on a fake body. usage: robot_main.py ROOT [arguments]"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from benchmarks.fixtures.fleet import STARTS, FakePlatform
from benchmarks.fixtures.lineform import PROGRAM
from koordgen.runtime.agent.process import main
from koordgen.runtime.config.settings import Settings


def body(settings: Settings, key: bytes | None) -> FakePlatform:
    return FakePlatform(STARTS[settings.pid])


if __name__ == "__main__":
    raise SystemExit(main(PROGRAM, body, Path(sys.argv[1]), sys.argv[2:]))
