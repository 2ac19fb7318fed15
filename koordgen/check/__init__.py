"""Syntax tree -> typed IR: names, types, who may write what, indices and divisors."""

from koordgen.check.program import check

__all__ = ["check"]
