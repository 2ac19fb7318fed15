"""Console: exit statuses, failures, and what commands print for people and machines."""

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

# One table for every command; docs/reference/cli.md prints it.
HOLDS, WRONG, USAGE, VIOLATED, INCONCLUSIVE, SURROUNDINGS, HOST, INTERNAL, INTERRUPTED = 0, 1, 2, 3, 4, 5, 6, 70, 130


class Failure(Exception):
    """Ends the command with a message, a way out, and an exit status."""

    def __init__(self, status: int, message: str, help: str = "") -> None:
        super().__init__(message)
        self.status = status
        self.help = help


def install(what: str) -> str:
    """Return how to install koordgen with an extra, as in "koordgen[prove]", for the running Python."""
    from koordgen.runtime.ops.host import pip_install

    return pip_install(f"'{what}'")


def print_document(options: Namespace, results: Mapping[str, object]) -> None:
    """Print the one JSON document of a command: the diagnostics that were collected, and its results."""
    import json

    from koordgen.lang.diagnostics import as_data

    diagnostics = [as_data(source, diagnostic) for source, diagnostic in options.collected]
    print(json.dumps({"diagnostics": diagnostics, **results}, indent=2), flush=True)


def show_rejected(rejected: Rejected, options: Namespace) -> None:
    tell(rejected.found, options)
    codes = [d.code for _, d in rejected.found if d.severity == "error"]
    if options.format == "text":
        say(f"{len(codes)} error{'s' if len(codes) != 1 else ''}; `koordgen explain {codes[0]}` tells more")


def tell(found: Collection[tuple[Source, Diagnostic]], options: Namespace) -> None:
    """All that a command has to say of the user's files, once: for machines a document, even when it is nothing."""
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
            say(render(diagnostic, source))


def output(options: Namespace) -> TextIO | None:
    """Where a command's own words go: aside when a document for machines has standard output, which None means."""
    return None if options.format == "text" else sys.stderr


def say(text: str) -> None:
    from koordgen.cli.base.terminal import coloured_message

    print(coloured_message(text, sys.stderr), file=sys.stderr)


def internal_error(error: Exception) -> int:
    import traceback

    traceback.print_exception(error)
    say(
        f"internal error: {error}\n"
        "  this is a mistake of koordgen, not of your program: please report it with the above"
    )
    return INTERNAL
