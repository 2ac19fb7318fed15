"""What can be made of a run that is over: `koordgen report` and `koordgen export`."""

from __future__ import annotations

from pathlib import Path

TRACE = "trace.jsonl"


def report(given: str, out: str | None) -> Path:
    """Write the report of a run's folder or merged trace; beside the trace unless `out` says where. Raises BadTrace,
    OSError."""
    from targets.sim.view import report

    trace = found(given)
    path = Path(out) if out else trace.parent / "report.html"
    report.write(path, trace)
    return path


def found(given: str) -> Path:
    """The trace that is meant: a file, or the one in a run's folder."""
    path = Path(given)
    return path / TRACE if path.is_dir() else path
