"""Runs this robot: `python3 <this folder>`, see README.md."""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent

if __name__ == "__main__":
    try:
        from koordgen.runtime.agent import main
        from program import PROGRAM
        from targets.car.platform import Car as Body
    except ImportError as missing:
        from koordgen.runtime.findings import tell_unloadable

        raise SystemExit(tell_unloadable(HERE, sys.argv[1:], missing)) from None
    raise SystemExit(main(PROGRAM, Body, HERE, sys.argv[1:]))
