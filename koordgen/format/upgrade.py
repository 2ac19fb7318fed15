"""The 2020 dialect -> the present one: makes the edits that the checker proposes."""

from __future__ import annotations

from koordgen.check import check
from koordgen.diagnostics import Diagnostic, InternalError
from koordgen.format.edits import applied, compatible
from koordgen.source import Source
from koordgen.syntax.parse import parse

DIALECT = "K050"
_ROUNDS = 10  # edits that are in the way of others are made one round later


def upgraded(source: Source) -> Source:
    """A program without syntax errors in the present dialect, as far as the checker knows how. Raises InternalError
    rather than give one that means something else."""
    meaning, notes = _checked(source)
    result = source
    for _ in range(_ROUNDS):
        if not notes:
            return result
        result = Source(source.path, applied(result.text, compatible(notes)))
        after, notes = _checked(result)
        if meaning is not None and after != meaning:
            raise InternalError(f"upgrading {source.path} would change its meaning; nothing was written")
    raise InternalError(f"upgrading {source.path} comes to no end; nothing was written")


def _checked(source: Source) -> tuple[object, list[Diagnostic]]:
    """What a program means, None when it is wrong; and the notes of its dialect that have edits."""
    tree, mistakes = parse(source)
    if any(d.severity == "error" for d in mistakes):
        raise InternalError(f"{source.path} cannot be read any more: {mistakes[0].message}; nothing was written")
    program, found = check(tree, source)
    return program, [d for d in found if d.code == DIALECT and d.edits]
