"""What `koordgen validate --reachsets` adds: where each platform of the fleet can get to on its way to one offset."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

from koordgen.cli.base import console
from koordgen.cli.base.terminal import Line
from koordgen.cli.experiment import campaign as campaigns
from koordgen.experiment.campaign import drive, store
from koordgen.experiment.validate.probe import BadProbe
from koordgen.experiment.validate.reach import Asked, comparisons, reachsets, written

FOLDER, RUNS = "reachsets", "probes"


def made(options: Namespace, out: Path, line: Line) -> dict[str, Any]:
    """Files, and how the platforms compare, as JSON has it; `text` is that for people. They are made anew with each
    call. Raises OSError, Unreachable."""
    folder = out / FOLDER
    asked = Asked(options.offset, options.epsilon, options.gamma, options.seed)
    show: Callable[[str], None] = (lambda _: None) if options.quiet else (lambda text: line.show(f"reachsets: {text}"))
    try:
        with closing(campaigns._crew(options)) as crew, campaigns._noticed_signals() as noticed:
            runs = store.cleared(folder / RUNS)
            found = reachsets(options.fleet, (), asked, crew, runs, show, lambda: bool(noticed))
        files = written(found, folder)
    except BadProbe as error:
        raise console.Failure(console.SURROUNDINGS, str(error), error.help) from None
    except drive.DiskFull:
        raise console.Failure(
            console.SURROUNDINGS, f"{folder}: the disk is full", "make room; the same command goes on"
        ) from None
    finally:
        line.end()
    tables = comparisons(found)
    told = [f"{r.platform}: {r.overshoot:+.2f} m beyond the target, {r.lateral:.2f} m to a side" for r in found]
    where = f"to ({', '.join(f'{v:g}' for v in asked.offset)}) m"
    text = "\n".join(
        [f"reachsets {where} ({folder}):", *(f"  {line}" for line in told), "", *(t.text() for t in tables)]
    )
    return {
        "offset": list(asked.offset), "files": [str(file) for file in files],
        "comparisons": [t.json() for t in tables], "text": text,
    }  # fmt: skip
