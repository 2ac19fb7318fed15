"""Run a benchmark with the shared memory's modules compiled, as on a robot after `--compile`.

`benchmarks.peers_memory` is compiled, too: in the benchmarks it stands for `agent.rounds`, which is among the modules.
"""

from __future__ import annotations

import os
import runpy
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from koordgen.runtime.native import protocol

MODULES = (*protocol.MODULES, "benchmarks.peers_memory")


def restart_compiled() -> None:
    """Start this process's benchmark anew with compiled modules, unless it runs with them. Raises NotCompiled."""
    if not protocol.is_used():
        print(f"compiled: {protocol.compile_modules(MODULES)}", flush=True)
        os.execv(sys.executable, [sys.executable, str(Path(__file__)), *sys.argv])


if __name__ == "__main__":
    assert protocol.use(MODULES), "restart_compiled has compiled them"
    sys.argv = sys.argv[1:]
    runpy.run_path(sys.argv[0], run_name="__main__")
