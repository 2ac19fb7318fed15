"""Start of the whole fleet on this host: `python3 <this folder>`, see README.md."""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent

if __name__ == "__main__":
    try:
        from targets.sim.harness import main
    except ModuleNotFoundError as missing:
        from koordgen.runtime.ops.host import install_requirements

        print(f"error: the Python package {missing.name!r} is missing\n"
              f"  help: {install_requirements(HERE)}", file=sys.stderr)
        raise SystemExit(5) from None
    raise SystemExit(main(HERE, sys.argv[1:]))
