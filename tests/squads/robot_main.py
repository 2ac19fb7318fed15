"""Process of an inner robot: a bundle of a squad on a fake body. usage: robot_main.py ROOT [arguments]"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.fixtures.fleet import FakePlatform
from koordgen.runtime.agent.process import main
from koordgen.runtime.config.settings import Settings
from koordgen.runtime.values.points import Point


def body(settings: Settings, key: bytes | None) -> FakePlatform:
    return FakePlatform(Point(settings.pid, settings.application_id, 1))


if __name__ == "__main__":
    root = Path(sys.argv[1])
    sys.path.insert(0, str(root))
    if (root / "squad.py").exists():
        fleet, squad = importlib.import_module("applications").FLEET, importlib.import_module("squad").SQUAD
        raise SystemExit(main(fleet, body, root, sys.argv[2:], squad=squad))
    raise SystemExit(main(importlib.import_module("program").PROGRAM, body, root, sys.argv[2:]))
