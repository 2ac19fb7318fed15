"""Formatting of files. Each file is formatted completely or left unchanged."""

from __future__ import annotations

import os
import stat
import sys
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from koordgen.lang.diagnostics import Diagnostic, as_data
from koordgen.lang.format import formatted
from koordgen.lang.node import Node, replace
from koordgen.lang.source import Source, Span
from koordgen.lang.syntax.parse import parse

if TYPE_CHECKING:
    from koordgen.lang.format.upgrade import Checker

STDIN = "-"


class FormatResult(Node):
    """Result of formatting one file.

    `before` is its text with byte order mark and line ends, `after` the formatted text; both are empty if there are
    `mistakes`. `refused` says why the file could not be written.
    """

    source: Source
    mistakes: tuple[Diagnostic, ...]
    before: str = ""
    after: str = ""
    refused: str = ""

    @property
    def changed(self) -> bool:
        return self.before != self.after


def format_file(path: str, checker: Checker | None, write: bool) -> FormatResult:
    """Format one file, or standard input for `-`.

    With a checker the program is also upgraded. `write`: replace the file if the text changes.
    """
    start = Span(1, 1, 1, 1)
    try:
        raw = sys.stdin.buffer.read() if path == STDIN else Path(path).read_bytes()
        source = Source(path, raw.decode("utf-8-sig"))
    except OSError as error:
        problem = Diagnostic("F100", "error", f"cannot be read: {error.strerror or error}", start)
        return FormatResult(Source(path, ""), (problem,))
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        problem = Diagnostic("F101", "error", f"byte {error.start} is not UTF-8", Span(line, 1, line, 2))
        return FormatResult(Source(path, ""), (problem,))
    tree, found = parse(source)
    mistakes = tuple(d for d in found if d.severity == "error")
    if mistakes:
        return FormatResult(source, mistakes)
    modern = source
    if checker is not None:
        from koordgen.lang.format.upgrade import upgraded

        modern = upgraded(source, checker)
        tree, _ = parse(modern)
    after = formatted(modern, tree)
    result = FormatResult(source, (), raw.decode(), after)
    if result.changed and write and path != STDIN:
        try:
            _replace(path, after.encode())
        except OSError as error:
            return replace(result, refused=f"{path}: {error.strerror or error}")
    return result


def output(results: Iterable[FormatResult], format: str, check: bool, diff: bool) -> bytes:
    """Return the bytes for standard output.

    These are the formatted text of standard input, the files that are or would be changed, or a diff. As JSON:
    `{"files": [{file, changed}], "diagnostics": [...]}`, where standard input also has its `text`.
    """
    dry = check or diff
    if format == "json":
        text = _json(results, not dry)
    elif diff:
        text = "".join(_difference(r) for r in results)
    else:
        text = "".join(_changed_line(r, dry) for r in results)
    return text.encode(errors="surrogateescape")  # file names need not be UTF-8


def _changed_line(result: FormatResult, dry: bool) -> str:
    if result.source.path == STDIN and not dry:
        return "" if result.mistakes else result.after
    if not result.changed or result.refused:
        return ""
    return f"{result.source.path}: {'would be formatted' if dry else 'formatted'}\n"


def _json(results: Iterable[FormatResult], texts: bool) -> str:
    import json

    files: list[dict[str, object]] = []
    diagnostics = []
    for result in results:
        files.append({"file": result.source.path, "changed": result.changed})
        if texts and result.source.path == STDIN and not result.mistakes:
            files[-1]["text"] = result.after
        diagnostics += [as_data(result.source, d) for d in result.mistakes]
    return json.dumps({"files": files, "diagnostics": diagnostics}, indent=2) + "\n"


def _difference(result: FormatResult) -> str:
    from difflib import unified_diff

    path = result.source.path
    return "".join(unified_diff(_lines(result.before), _lines(result.after), path, f"{path} (formatted)"))


def _lines(text: str) -> list[str]:
    *lines, last = text.split("\n")
    return [f"{line}\n" for line in lines] + [f"{last}\n\\ No newline at end of file\n"] * bool(last)


def _replace(path: str, data: bytes) -> None:
    """Replace a file's content by a rename. For a symbolic link, its target is replaced.

    If it raises OSError, the file is unchanged.
    """
    target = os.path.realpath(path)
    status = os.stat(path)
    if not stat.S_ISREG(status.st_mode):
        raise OSError("is not a regular file")
    # Checked here, because a rename ignores a file's mode, and root passes `access`.
    if not status.st_mode & 0o222 or not os.access(target, os.W_OK):
        raise OSError("is read-only")
    folder, name = os.path.split(target)
    beside = os.path.join(folder, f".{name}.{os.getpid()}")
    descriptor = os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            with suppress(PermissionError):  # another user's file in a folder that this user may write
                os.fchown(descriptor, status.st_uid, status.st_gid)
            os.fchmod(descriptor, stat.S_IMODE(status.st_mode))
        os.replace(beside, target)
    except BaseException:
        os.unlink(beside)
        raise
