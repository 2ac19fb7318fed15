"""The table of what expressions mean has all of them: mypy cannot see that, as it can of a `match`."""

from __future__ import annotations

from typing import get_args

from koordgen.lang.ir import expr
from koordgen.lang.semantics.eval import MEANINGS


def test_every_expression_means_something() -> None:
    assert set(MEANINGS) == set(get_args(expr.Expr))
