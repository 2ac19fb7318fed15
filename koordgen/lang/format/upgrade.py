"""The 2020 dialect -> the present one: makes the edits that the checker proposes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from koordgen.lang.diagnostics import Diagnostic, Edit, InternalError
from koordgen.lang.source import Source
from koordgen.lang.syntax.decl import Program
from koordgen.lang.syntax.parse import parse

# Edits of a text, as diagnostics propose them.


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


# Gives what a program means (None when it is wrong), comparable by `==`, and all that there is to say of it.
Checker = Callable[[Program, Source], tuple[object, list[Diagnostic]]]

DIALECT = "K050"
_ROUNDS = 10  # edits that are in the way of others are made one round later


def upgraded(source: Source, check: Checker) -> Source:
    """A program without syntax errors in the present dialect, as far as the checker knows how. Raises InternalError
    rather than give one that means something else."""
    meaning, notes = _checked(source, check)
    result = source
    for _ in range(_ROUNDS):
        if not notes:
            return result
        result = Source(source.path, applied(result.text, compatible(notes)))
        after, notes = _checked(result, check)
        if meaning is not None and after != meaning:
            raise InternalError(f"upgrading {source.path} would change its meaning; nothing was written")
    raise InternalError(f"upgrading {source.path} comes to no end; nothing was written")


def _checked(source: Source, check: Checker) -> tuple[object, list[Diagnostic]]:
    """What a program means, and the notes of its dialect that have edits."""
    tree, mistakes = parse(source)
    if any(d.severity == "error" for d in mistakes):
        raise InternalError(f"{source.path} cannot be read any more: {mistakes[0].message}; nothing was written")
    meaning, found = check(tree, source)
    return meaning, [d for d in found if d.code == DIALECT and d.edits]
