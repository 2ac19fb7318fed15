"""Start of this robot: `python3 <this folder>`, see README.md."""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent

if __name__ == "__main__":
    if sys.version_info < (3, 10):
        print(f"error: {sys.executable} is Python {sys.version.split()[0]}\n"
              "  help: install Python 3.10 or later, and start the bundle with it", file=sys.stderr)
        raise SystemExit(5)
    try:
        from koordgen.runtime.native import protocol

        protocol.use()  # the compiled modules, if `--compile` has made them: before any of them is imported
        from koordgen.runtime.agent.process import main
        from program import PROGRAM
        from targets.quad.platform.platform import Quad as Body
    except ImportError as missing:
        from koordgen.runtime.ops.checks import report_unloadable

        raise SystemExit(report_unloadable(HERE, sys.argv[1:], missing)) from None
    drivers = {}
    raise SystemExit(main(PROGRAM, Body, HERE, sys.argv[1:], drivers))
