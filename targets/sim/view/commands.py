"""What can be made of a run that is over: `koordgen report` and `koordgen export`."""

from __future__ import annotations

from pathlib import Path

TRACE = "trace.jsonl"
FORMATS = ("mcap", "csv", "png", "gif", "mp4")


class CannotMake(Exception):
    """Something that is needed is not there; the message says what, `hint` the way out."""

    def __init__(self, message: str, hint: str) -> None:
        super().__init__(message)
        self.hint = hint


def report(given: str, out: str | None) -> Path:
    """Write the report of a run's folder or merged trace; beside the trace unless `out` says where. Raises BadTrace,
    OSError."""
    from targets.sim.view import report

    trace = _found(given)
    path = Path(out) if out else trace.parent / "report.html"
    report.write(path, trace)
    return path


def export(given: str, to: str, out: str | None) -> Path:
    """Write a run's folder or merged trace as another format, one of FORMATS: tables and pictures into a folder, all
    else into a file; beside the trace unless `out` says where. Raises BadTrace, CannotMake, OSError."""
    from targets.sim.trace import read

    trace = _found(given)
    path = Path(out) if out else trace.with_name({"csv": "csv", "png": "plots"}.get(to, f"{trace.stem}.{to}"))
    header, records = read(trace)
    match to:
        case "csv":
            from targets.sim.view import tables

            tables.write(path, header, records)
        case "mcap":
            try:
                from targets.sim.view import recording
            except ModuleNotFoundError as error:
                raise CannotMake(f"the package {error.name} is missing", "pip install mcap") from None
            recording.write(path, header, records)
        case "png" | "gif" | "mp4":
            from targets.sim.view import film, plots
            from targets.sim.view.history import gathered
            from targets.sim.view.tracks import tracks

            found = tracks(header, gathered(header, records))
            if to == "png":
                plots.draw(found, path)
            else:
                film.write(path, found)
    return path


def _found(given: str) -> Path:
    """The trace that is meant: a file, or the one in a run's folder."""
    path = Path(given)
    return path / TRACE if path.is_dir() else path
