"""The 2020 dialect -> the present one: applies the edits that the checker proposes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from koordgen.check import check
from koordgen.diagnostics import Diagnostic, Edit, InternalError
from koordgen.source import Source
from koordgen.syntax.parse import parse

DIALECT = "K050"
_ROUNDS = 10  # edits that overlap wait for the next round


def applied(text: str, edits: Iterable[Edit]) -> str:
    """The text with all edits made. They must not overlap: ValueError. What is inserted at one place stands in the
    order of the edits."""
    starts = [0]
    starts.extend(i + 1 for i, c in enumerate(text) if c == "\n")
    parts: list[str] = []
    done = 0
    for edit in sorted(edits, key=_place):
        span = edit.span
        start = starts[span.line - 1] + span.column - 1
        if start < done:
            raise ValueError(f"edits overlap in line {span.line}")
        parts += [text[done:start], edit.text]
        done = starts[span.end_line - 1] + span.end_column - 1
    return "".join([*parts, text[done:]])


def upgraded(source: Source) -> Source:
    """The program in the present dialect, as far as the checker knows how; with syntax errors, as it is. Raises
    InternalError when that would change its meaning."""
    meaning, notes = _checked(source)
    result = source
    for _ in range(_ROUNDS):
        if not notes:
            return result
        result = Source(source.path, applied(result.text, _chosen(notes)))
        after, notes = _checked(result)
        if meaning is not None and after != meaning:
            raise InternalError(f"upgrading {source.path} would change its meaning; nothing was written")
    raise InternalError(f"upgrading {source.path} comes to no end; nothing was written")


def _checked(source: Source) -> tuple[object, list[Diagnostic]]:
    """What the program means, None when it is wrong, and the notes of its dialect that have edits."""
    tree, found = parse(source)
    if any(d.severity == "error" for d in found):
        return None, []
    program, found = check(tree, source)
    return program, [d for d in found if d.code == DIALECT and d.edits]


def _chosen(notes: Sequence[Diagnostic]) -> list[Edit]:
    """The edits of notes that do not meet: a note is taken whole, or left when an earlier one is in its way."""
    taken: list[Edit] = []
    for note in notes:
        if not any(_overlap(a, b) for a in note.edits for b in taken):
            taken += note.edits
    return taken


def _overlap(a: Edit, b: Edit) -> bool:
    first, second = sorted((_place(a), _place(b)))
    return second[0] < first[1]


def _place(edit: Edit) -> tuple[tuple[int, int], tuple[int, int]]:
    span = edit.span
    return (span.line, span.column), (span.end_line, span.end_column)
