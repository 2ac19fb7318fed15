"""Exact numbers of a proof, which a trace has as texts where they are no floats, beside the floats of robots."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from fractions import Fraction
from math import isclose
from typing import Any

ROUNDING = 1e-9  # relative: what exact numbers of a proof may differ from floats
EXACT = re.compile(r"-?[0-9]+/[0-9]+")


def fraction(data: Any) -> str:
    """The first such text in JSON; empty where there is none."""
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
    """The float nearest to a number, as near as floats are to one another. Raises ValueError, TypeError,
    ArithmeticError, for what is too great or too small among others."""
    if not fraction(data):
        return float(data)
    exact = Fraction(data)
    near = float(exact)
    if abs(exact - Fraction(near)) > abs(exact) * Fraction(sys.float_info.epsilon):
        raise ValueError
    return near


def agree(told: Any, meant: Any, rounded: bool = False) -> bool:
    """Whether two values in JSON are the same; of exact numbers, which are texts, up to the rounding of floats, and so
    of all that may have come of one that was `rounded`."""
    if isinstance(told, list) and isinstance(meant, list):
        return len(told) == len(meant) and all(agree(t, m, rounded) for t, m in zip(told, meant, strict=True))
    exact = isinstance(told, str) or (rounded and type(told) in (int, float) and isinstance(meant, float))
    if exact and isinstance(meant, (int, float)) and not isinstance(meant, bool):
        try:
            return isclose(Fraction(told), meant, rel_tol=ROUNDING, abs_tol=ROUNDING)
        except (ValueError, ArithmeticError):
            return False
    if isinstance(told, bool) != isinstance(meant, bool):
        return False
    return bool(told == meant) or (meant is None and told in ("inf", "-inf", "nan"))
