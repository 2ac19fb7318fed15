"""K029: a function that can end without a result."""

from __future__ import annotations

from koordgen.lang.ir import decl, stmt
from koordgen.lang.ir.draft import UnparsedStmt
from koordgen.lang.ir.tree import walk
from koordgen.lang.ir.types import POISON
from koordgen.lang.reporter import Reporter


def check_end(function: decl.Function, reporter: Reporter) -> None:
    """Report a function whose end is reachable without 'return', unless a statement in it could not be parsed."""
    parts = list(walk(function.block))
    if any(isinstance(part, UnparsedStmt) for part in parts):
        return
    none = function.result is POISON and not any(isinstance(part, stmt.Return) for part in parts)
    message = f"the function {function.name} {'has no' if none else 'can end without'} 'return'"
    reporter.report("error", "K029", message, function.span, "end every path through the function with 'return value'")
