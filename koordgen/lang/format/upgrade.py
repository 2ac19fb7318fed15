"""The 2020 dialect -> the present one: makes the edits that the checker proposes."""

from __future__ import annotations

from collections.abc import Callable

from koordgen.lang.diagnostics import Diagnostic, InternalError
from koordgen.lang.format.edits import applied, compatible
from koordgen.lang.source import Source
from koordgen.lang.syntax.decl import Program
from koordgen.lang.syntax.parse import parse

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
