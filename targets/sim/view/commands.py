"""Commands on a finished run: `koordgen report`, `koordgen export` and `koordgen show`."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from targets.sim.base import folder

if TYPE_CHECKING:
    from koordgen.runtime.trace.schema import Header, TraceRecord

TRACE = "trace.jsonl"
FORMATS = ("mcap", "csv", "png", "gif", "mp4")


def report(given: str, out: str | None) -> Path:
    """Write the report of a run's folder or merged trace to `out`, by default beside the trace.

    Raises BadTrace, OSError."""
    from targets.sim.view.web import report

    trace = _found(given)
    path = Path(out) if out else trace.parent / "report.html"
    with whole(path) as made:
        report.write(made, trace)
    return path


def export(given: str, to: str, out: str | None) -> Path:
    """Write a run's folder or merged trace in another format, one of FORMATS.

    Tables and pictures become a folder, others a file; by default beside the trace. Raises BadTrace, CannotMake,
    OSError."""
    from targets.sim.trace.files import read

    trace = _found(given)
    path = Path(out) if out else trace.with_name({"csv": "csv", "png": "plots"}.get(to, f"{trace.stem}.{to}"))
    header, records = read(trace)
    with whole(path) as made:
        _write(to, made, header, records)
    return path


def show(given: str, at: float | None, form: str) -> str:
    """Return the values that each robot knew at a time (s since round 1), as `text` or `json`.

    Without a time: at the first violation, otherwise at the mission's end. Raises BadTrace."""
    from targets.sim.trace.files import read
    from targets.sim.view.data import show

    header, records = read(_found(given))
    time, beliefs = show.at(header, records, at)
    return (show.as_json if form == "json" else show.as_text)(header, time, beliefs)


def upgrade(given: str, out: str | None) -> tuple[Path, str]:
    """Write any trace (of a run, a robot or a counterexample) in the present format.

    `out` is by default beside the trace. Returns the new file, and the old format. Raises BadTrace, OSError."""
    from koordgen.runtime.trace.schema import FORMAT
    from targets.sim.trace.files import upgrade

    trace = _found(given)
    path = Path(out) if out else trace.with_name(f"{trace.stem}.{FORMAT.replace('/', '-')}")
    with whole(path) as made:
        old = upgrade(trace, made)
    return path, old


def _write(to: str, path: Path, header: Header, records: Iterator[TraceRecord]) -> None:
    match to:
        case "csv":
            from targets.sim.view.data import tables

            tables.write(path, header, records)
        case "mcap":
            from targets.sim.view.foxglove import recording

            recording.write(path, header, records)
        case "png" | "gif" | "mp4":
            from targets.sim.view.data.history import gathered
            from targets.sim.view.data.tracks import tracks
            from targets.sim.view.pictures import film, plots

            found = tracks(header, gathered(header, records))
            if to == "png":
                plots.draw(found, path)
            else:
                film.write(path, found, to == "mp4")


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Context manager that yields a temporary path and moves the result to `path` on success.

    `path` is a file or a folder of files. So it never holds half a result, and a failure loses nothing that was there.
    A path that is no regular file (`/dev/stdout`) is written directly. Raises OSError that names `path`."""
    if path.exists() and not path.is_file() and not path.is_dir():
        yield path
        return
    try:
        target = path.resolve()
        with tempfile.TemporaryDirectory(prefix=".koordgen-", dir=target.parent) as beside:
            made = Path(beside) / target.name
            yield made
            _moved(made, target)
            folder.record(target)
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(path)) from None


def _moved(made: Path, target: Path) -> None:
    if made.is_dir() and target.is_dir():
        for each in made.iterdir():
            each.replace(target / each.name)
    else:
        made.replace(target)


def _found(given: str) -> Path:
    """Return the path of the trace: a file, or the one in a run's folder."""
    path = Path(given)
    return path / TRACE if path.is_dir() else path
