"""Console: exit statuses, failures, and printing of messages and diagnostics as text, JSON or SARIF."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Collection, Mapping
    from typing import TextIO

    from koordgen.build.pipeline import Rejected
    from koordgen.lang.diagnostics import Diagnostic
    from koordgen.lang.source import Source

# Exit statuses of all commands, as in the table of docs/reference/cli.md.
HOLDS, WRONG, USAGE, VIOLATED, INCONCLUSIVE, SURROUNDINGS, HOST, INTERNAL, INTERRUPTED = 0, 1, 2, 3, 4, 5, 6, 70, 130


class Failure(Exception):
    """Raised to end a command with an exit status, a message, and a help text that says what to do."""

    def __init__(self, status: int, message: str, help: str = "") -> None:
        super().__init__(message)
        self.status = status
        self.help = help


def install(what: str) -> str:
    """Return the command that installs `what`, for example "koordgen[prove]", for the running Python."""
    from koordgen.runtime.ops.host import pip_install

    return pip_install(f"'{what}'")


def print_document(options: Namespace, results: Mapping[str, object]) -> None:
    """Print the JSON document of a command: the collected diagnostics, and the results."""
    import json

    from koordgen.lang.diagnostics import as_data

    diagnostics = [as_data(source, diagnostic) for source, diagnostic in options.collected]
    print(json.dumps({"diagnostics": diagnostics, **results}, indent=2), flush=True)


def show_rejected(rejected: Rejected, options: Namespace) -> None:
    """Print the diagnostics of rejected files; with `--format text` also the number of errors."""
    print_diagnostics(rejected.found, options)
    codes = [d.code for _, d in rejected.found if d.severity == "error"]
    if options.format == "text":
        notify(f"{len(codes)} error{'s' if len(codes) != 1 else ''}; `koordgen explain {codes[0]}` tells more")


def print_diagnostics(found: Collection[tuple[Source, Diagnostic]], options: Namespace) -> None:
    """Print diagnostics in the format of the options. JSON and SARIF are one document, even without diagnostics."""
    if options.format == "json":
        from koordgen.lang.diagnostics import to_json

        print(to_json(found), flush=True)
    elif options.format == "sarif":
        from pathlib import Path

        from koordgen.cli.base.sarif import to_sarif

        print(to_sarif(found, Path.cwd()), flush=True)
    elif found:
        from koordgen.lang.diagnostics import render

        for source, diagnostic in found:
            notify(render(diagnostic, source))


def output(options: Namespace) -> TextIO | None:
    """Return the stream for other output: None (standard output) in text format, stderr in JSON and SARIF."""
    return None if options.format == "text" else sys.stderr


def notify(text: str) -> None:
    """Print a message to stderr, with colours on a terminal."""
    from koordgen.cli.base.terminal import coloured_message

    print(coloured_message(text, sys.stderr), file=sys.stderr)


def internal_error(error: Exception) -> int:
    import traceback

    traceback.print_exception(error)
    notify(
        f"internal error: {error}\n"
        "  this is a bug of koordgen, not an error in your program: please report it with the lines above"
    )
    return INTERNAL
