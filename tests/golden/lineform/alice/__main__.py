"""Runs this robot: `python3 <this folder>`, see README.md."""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent

if __name__ == "__main__":
    try:
        from koordgen.runtime.agent import main
        from program import PROGRAM
        from targets.quad.platform import Quad as Body
    except ModuleNotFoundError as missing:
        print(f"error: the Python package {missing.name!r} is missing\n"
              f"  help: {sys.executable} -m pip install -r {HERE / 'requirements.txt'}", file=sys.stderr)
        raise SystemExit(5) from None
    raise SystemExit(main(PROGRAM, Body, HERE, sys.argv[1:]))
