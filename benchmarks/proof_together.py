"""Proof of several programs in one process, for any number of robots: `proof_together.py APP.koord...`.

Prints wall-clock and CPU seconds beyond the start of Python and the front end. `proof_tables.py` runs it.
"""

from __future__ import annotations

import gc
import resource
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from koordgen.build.pipeline import check_file


def _cpu() -> float:
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def main(paths: list[str]) -> None:
    gc.disable()  # as the command does
    programs = [check_file(path).program for path in paths]
    began, before = time.perf_counter(), _cpu()
    from koordgen.verify.prove.smt.solve import Limits, solver_of

    with solver_of("z3", Limits()) as solver:
        solver.start()
        from koordgen.verify.prove.report.verdict import Question, prove  # while the solver loads, as the command does

        verdicts = [verdict for program in programs for verdict in prove(Question(program, None, {}), solver)]
        solver.stop()
    print(time.perf_counter() - began, _cpu() - before)
    left = [verdict.invariant for verdict in verdicts if verdict.verdict != "PROVED"]
    if left:
        sys.exit(f"not proved: {', '.join(left)}")


if __name__ == "__main__":
    main(sys.argv[1:])
