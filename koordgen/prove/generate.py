"""From a program to its obligations."""

from __future__ import annotations

from collections.abc import Mapping

from koordgen.ir.decl import Program
from koordgen.ir.expr import Expr
from koordgen.prove.obligation import Obligation


def obligations(
    program: Program, robots: int | None = None, params: Mapping[str, Expr] | None = None
) -> list[Obligation]:
    """Everything that is to be shown of a checked program: for `robots` robots, or for any number of them; with the
    values of `params`, the others being any. To leave an invariant out, or to add one, hand over a program without or
    with it."""
    raise NotImplementedError
