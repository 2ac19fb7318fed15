"""Colours and dashes that distinguish robots and states, also for colour-blind readers."""

from __future__ import annotations

from typing import Any

# Okabe and Ito, Color Universal Design (2008), without yellow, which vanishes on white. page/draw.js has the same.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
DASHES: tuple[Any, ...] = ("-", (0, (6, 2)), (0, (2, 1.5)), (0, (6, 2, 1.5, 2)))
RED, AMBER, GREEN, VIOLET, GREY, STONE = "#B00020", "#E69F00", "#1B7F4B", "#6B4C9A", "#777777", "#CCCCCC"
STATES = (VIOLET, AMBER, GREEN)  # of markers: to do, taken, done


def of_robot(pid: int) -> str:
    return COLOURS[pid % len(COLOURS)]


def rgba(colour: str, alpha: float = 1.0) -> dict[str, float]:
    """Return a colour as RGBA parts between 0 and 1."""
    r, g, b = (round(int(colour[k : k + 2], 16) / 255, 4) for k in (1, 3, 5))
    return {"r": r, "g": g, "b": b, "a": alpha}
