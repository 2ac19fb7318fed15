"""Edits of a text, as diagnostics propose them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from koordgen.lang.diagnostics import Diagnostic, Edit


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


def compatible(notes: Sequence[Diagnostic]) -> list[Edit]:
    """The edits of diagnostics that do not meet: one's edits are taken together, or left when an earlier one is in
    their way."""
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
