"""Kinds of breaches, from the geometry of one window."""

from __future__ import annotations

import pytest

from koordgen.experiment.validate.breach import BoxBreach, ConsecutiveBreaches, kind

FAR, NEAR, HERE = (5.0, 0.0, 0.0), (0.05, 0.0, 0.0), (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("target", "before", "out", "then", "found"),
    [
        (NEAR, (1.0, 0.0, 0.0), (0.05, 0.0, 0.0), (0.9, 0.0, 0.0), "overshoot"),  # past it
        ((-1.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.09, 0.0, 0.0), (0.8, 0.0, 0.0), "overshoot"),  # already past, brakes
        (HERE, (0.5, 0.0, 0.0), (0.04, 0.01, 0.0), (0.4, 0.0, 0.0), "overshoot"),  # from the very target
        ((-1.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.02, 0.0, 0.0), (0.3, 0.0, 0.0), "away"),  # drives off
        (FAR, (0.4, 0.4, 0.0), (0.0, 0.04, 0.0), (0.4, 0.4, 0.0), "across"),
        (FAR, (0.0, -0.5, 0.0), (-0.01, -0.04, 0.0), (0.1, -0.5, 0.0), "across"),
        (FAR, (0.01, 0.0, 0.0), (0.0, 0.001, 0.0), (0.01, 0.0, 0.0), "drift"),
        # What is below it does not matter to where it goes in plan; a climb past its height is one.
        ((0.05, 0.0, -1.5), (1.0, 0.0, 0.0), (0.05, 0.0, 0.001), (0.9, 0.0, 0.0), "overshoot"),
        ((5.0, 0.0, 0.1), (1.0, 0.0, 0.5), (0.0, 0.001, 0.05), (1.0, 0.0, 0.3), "overshoot"),
    ],
)  # fmt: skip
def test_kinds(target: object, before: object, out: object, then: object, found: str) -> None:
    assert kind(HERE, target, before, out, then) == found  # type: ignore[arg-type]


def test_windows_in_a_row_add_up() -> None:
    row = ConsecutiveBreaches()
    assert row.add(0, 0.0, (0.03, 0.0, 0.0), "across") == BoxBreach(0, 0.0, (0.03, 0.0, 0.0), "across", 0.03, "across")
    second = row.add(0, 0.1, (0.01, 0.03, 0.0), "overshoot")
    assert second.together == pytest.approx(0.05) and second.main == "overshoot"
    assert row.add(0, 0.2, (0.0, 0.001, 0.0), "drift").main == "overshoot", "that in which it went farthest"
