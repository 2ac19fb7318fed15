"""Formatter: one style for programs, and upgrades of the 2020 dialect.

Owns: spacing, indentation, blank lines, comments, edits that modernise programs.
Offers: `formatted` and `files.format_file`.
Must not import: IR, or any package above `lang`.
"""

from __future__ import annotations

from typing import Any

from koordgen.lang.diagnostics import InternalError
from koordgen.lang.format.arrange import arranged
from koordgen.lang.node import Node
from koordgen.lang.source import Source, Span
from koordgen.lang.syntax.parse import parse


def formatted(source: Source, tree: object) -> str:
    """Return the formatted text of a program without syntax errors; `tree` is its syntax tree.

    Raises InternalError if the result would have another syntax tree.
    """
    text = arranged(source.text)
    again, found = parse(Source(source.path, text))
    if any(d.severity == "error" for d in found) or not same(tree, again):
        raise InternalError(f"formatting {source.path} would change its meaning; nothing was written")
    return text


def same(one: Any, other: Any) -> bool:
    """Return whether two trees are equal, ignoring all spans. `==` would compare the spans of names."""
    pending = [(one, other)]
    while pending:
        a, b = pending.pop()
        if type(a) is not type(b):
            return False
        if isinstance(a, Span):
            continue
        if isinstance(a, tuple):
            if len(a) != len(b):
                return False
            pending.extend(zip(a, b, strict=True))
        elif isinstance(a, Node):
            pending.extend((getattr(a, f), getattr(b, f)) for f in type(a).__match_args__)  # type: ignore[attr-defined]
        elif a != b:
            return False
    return True
