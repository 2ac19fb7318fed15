"""Parser: text to syntax tree, one section at a time, with error recovery."""

from __future__ import annotations

import gc
from typing import Any

from koordgen.lang.diagnostics import Diagnostic, in_order
from koordgen.lang.source import Source
from koordgen.lang.syntax import build, decl
from koordgen.lang.syntax.layout import sections
from koordgen.lang.syntax.lr import UnexpectedToken, section


def parse(source: Source) -> tuple[decl.Program, list[Diagnostic]]:
    """Return the syntax tree of a text and its diagnostics.

    Text that could not be parsed is in the tree as broken nodes. Without diagnostics the text is right.
    """
    collecting = gc.isenabled()
    gc.disable()  # a tree has no cycles; collecting while it grows doubles the time of a long program
    try:
        chunks = sections(source)
        read: list[Any] = []
        found: list[Diagnostic] = []
        for chunk in chunks:
            wrong: UnexpectedToken | build.BuilderError | None = None
            if not chunk.faults:
                try:
                    read.append(section(chunk.tokens, chunk.long))
                    continue
                except (UnexpectedToken, build.BuilderError) as error:
                    wrong = error
            from koordgen.lang.syntax.recover import recovered

            read.append(recovered(chunk, found, wrong))
    finally:
        if collecting:
            gc.enable()
    return decl.Program(tuple(read)), in_order(found)
