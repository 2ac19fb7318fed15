"""Upgrade of programs from the 2020 dialect: applies the edits that the checker proposes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from koordgen.lang.diagnostics import Diagnostic, Edit, InternalError
from koordgen.lang.source import Source
from koordgen.lang.syntax.decl import Program
from koordgen.lang.syntax.parse import parse

# Edits that diagnostics propose


def apply_edits(text: str, edits: Iterable[Edit]) -> str:
    """Return the text with all edits applied. Raises ValueError if they overlap.

    Insertions at the same position are in the order of the edits.
    """
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


def non_overlapping(notes: Sequence[Diagnostic]) -> list[Edit]:
    """Return edits that do not overlap.

    The edits of one diagnostic are taken together, or left out if they overlap with those of an earlier one.
    """
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


# Checks a program: returns its meaning, comparable by `==` (None if there are errors), and its diagnostics.
Checker = Callable[[Program, Source], tuple[object, list[Diagnostic]]]

DIALECT = "K050"
_ROUNDS = 10  # edits that overlap with others are applied in a later round


def upgraded(source: Source, check: Checker) -> Source:
    """Upgrade a program without syntax errors to the present dialect, by edits that the checker proposes.

    Raises InternalError if the result would have another meaning.
    """
    meaning, notes = _checked(source, check)
    result = source
    for _ in range(_ROUNDS):
        if not notes:
            return result
        result = Source(source.path, apply_edits(result.text, non_overlapping(notes)))
        after, notes = _checked(result, check)
        if meaning is not None and after != meaning:
            raise InternalError(f"upgrading {source.path} would change its meaning; nothing was written")
    raise InternalError(f"upgrading {source.path} does not terminate; nothing was written")


def _checked(source: Source, check: Checker) -> tuple[object, list[Diagnostic]]:
    """Return a program's meaning, and the diagnostics about its dialect that have edits."""
    tree, mistakes = parse(source)
    if any(d.severity == "error" for d in mistakes):
        raise InternalError(f"{source.path} can no longer be parsed: {mistakes[0].message}; nothing was written")
    meaning, found = check(tree, source)
    return meaning, [d for d in found if d.code == DIALECT and d.edits]
