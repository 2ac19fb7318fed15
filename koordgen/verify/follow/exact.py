"""Comparison of exact numbers, which a counterexample's trace stores as text, with robots' floats."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from fractions import Fraction
from math import isclose
from typing import Any

ROUNDING = 1e-9  # relative and absolute tolerance between an exact number and a float
EXACT = re.compile(r"-?[0-9]+/[0-9]+")


def fraction(data: Any) -> str:
    """Return the first fraction, such as "1/3", in a JSON value; empty if the value has no fraction."""
    match data:
        case str() if EXACT.fullmatch(data):
            return data
        case list() | tuple():
            return next(filter(None, map(fraction, data)), "")
        case Mapping():
            return fraction(list(data.values()))
        case _:
            return ""


def nearest(data: Any) -> float:
    """Return the float that is nearest to a number of a trace, which may be a fraction as text.

    Raises ValueError, TypeError or ArithmeticError. An example is a number so large or so small that no float is near
    it."""
    if not fraction(data):
        return float(data)
    exact = Fraction(data)
    near = float(exact)
    if abs(exact - Fraction(near)) > abs(exact) * Fraction(sys.float_info.epsilon):
        raise ValueError
    return near


def agree(recorded: Any, computed: Any, rounded: bool = False) -> bool:
    """Return whether a value in the trace and a computed value, both in JSON, agree.

    An exact number in the trace is a text, and may differ from the float by ROUNDING. If `rounded`, all floats may
    differ by ROUNDING, because they were computed from a rounded state."""
    if isinstance(recorded, list) and isinstance(computed, list):
        return len(recorded) == len(computed) and all(
            agree(t, m, rounded) for t, m in zip(recorded, computed, strict=True)
        )
    exact = isinstance(recorded, str) or (rounded and type(recorded) in (int, float) and isinstance(computed, float))
    if exact and isinstance(computed, (int, float)) and not isinstance(computed, bool):
        try:
            return isclose(Fraction(recorded), computed, rel_tol=ROUNDING, abs_tol=ROUNDING)
        except (ValueError, ArithmeticError):
            return False
    if isinstance(recorded, bool) != isinstance(computed, bool):
        return False
    return bool(recorded == computed) or (computed is None and recorded in ("inf", "-inf", "nan"))
