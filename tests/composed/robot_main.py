"""A robot's process: the applications in a folder of generated modules on a fake body. usage: robot_main.py ROOT"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from koordgen.runtime.agent.process import main
from tests.runtime.agent.robot_main import body

if __name__ == "__main__":
    sys.path.insert(0, sys.argv[1])
    raise SystemExit(main(importlib.import_module("applications").FLEET, body, Path(sys.argv[1]), sys.argv[2:]))
