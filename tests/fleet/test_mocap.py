"""Frames of motion capture systems: the fleet file's section, and the transformation of poses."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from koordgen.fleet.mocap import Mocap, Quaternion, Vector
from tests.fleet.test_fleet import GOOD, read

LEVEL: Quaternion = (0.0, 0.0, 0.0, 1.0)


def about(axis: Vector, angle: float) -> Quaternion:
    s = math.sin(angle / 2)
    return axis[0] * s, axis[1] * s, axis[2] * s, math.cos(angle / 2)


@pytest.mark.parametrize(
    ("text", "mocap"),
    [
        ("", Mocap()),
        ("mocap: {}", Mocap()),
        ("mocap: {up: y}", Mocap(up="y")),
        ("mocap: {yaw: 1.57, offset: [1, -2.5, 0]}", Mocap(yaw=1.57, offset=(1.0, -2.5, 0.0))),
    ],
)
def test_it_is_read(text: str, mocap: Mocap) -> None:
    fleet, found = read(f"{text}\n{GOOD}")
    assert found == [] and fleet is not None and fleet.mocap == mocap


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("mocap: {up: x}", "F005"), ("mocap: {up: 3}", "F004"), ("mocap: {yaw: 10}", "F005"),
        ("mocap: {offset: [1, 2]}", "F004"), ("mocap: {scale: 2}", "F002"), ("mocap: y", "F004"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told_where_it_stands(text: str, code: str) -> None:
    fleet, found = read(f"{text}\n{GOOD}")
    assert fleet is None and [(c, line) for c, line, *_ in found] == [(code, 1)]


def test_a_frame_that_is_ours_changes_nothing() -> None:
    found = Mocap().pose((1.0, 2.0, 3.0), about((0, 0, 1), 0.7))
    assert found is not None and found[0] == (1.0, 2.0, 3.0) and found[1] == pytest.approx(0.7)


def test_a_frame_that_is_turned_and_moved() -> None:
    """Its x axis points north; its origin is 4 m east of ours."""
    found = Mocap(yaw=math.pi / 2, offset=(4.0, 0.0, 0.1)).pose((1.0, 2.0, 3.0), about((0, 0, 1), 0.7))
    assert found is not None
    assert found[0] == pytest.approx((2.0, 1.0, 3.1)) and found[1] == pytest.approx(0.7 + math.pi / 2)


def test_a_frame_whose_y_axis_points_up() -> None:
    """x to the right, y up, so z towards the viewer: points in front of the viewer have a negative z."""
    found = Mocap(up="y").pose((1.0, 1.5, -2.0), about((0, 1, 0), 0.7))
    assert found is not None and found[0] == pytest.approx((1.0, 2.0, 1.5)) and found[1] == pytest.approx(0.7)


@given(st.floats(-3.1, 3.1), st.floats(-1.2, 1.2), st.floats(-1.2, 1.2))
def test_the_heading_is_where_the_nose_points_however_it_tilts(yaw: float, pitch: float, roll: float) -> None:
    """Yaw, then pitch, then roll: the last two keep the direction of the nose in plan view."""

    def times(a: Quaternion, b: Quaternion) -> Quaternion:
        ax, ay, az, aw = a
        bx, by, bz, bw = b
        return (
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        )

    tilted = times(times(about((0, 0, 1), yaw), about((0, 1, 0), pitch)), about((1, 0, 0), roll))
    for sign in (1.0, -1.0):  # both quaternions are the same rotation
        x, y, z, w = (sign * 1.05 * part for part in tilted)  # not quite of length 1
        found = Mocap().pose((0.0, 0.0, 0.0), (x, y, z, w))
        assert found is not None and math.remainder(found[1] - yaw, math.tau) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("position", "rotation"),
    [
        ((math.nan, 0.0, 0.0), LEVEL),
        ((0.0, math.inf, 0.0), LEVEL),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)),
        ((0.0, 0.0, 0.0), (0.0, 0.0, math.nan, 1.0)),
        ((0.0, 0.0, 0.0), about((0, 1, 0), math.pi / 2)),
    ],
)
def test_what_is_no_pose(position: Vector, rotation: Quaternion) -> None:
    assert Mocap().pose(position, rotation) is None


@given(st.tuples(*[st.floats()] * 3), st.tuples(*[st.floats()] * 4))
def test_nothing_yields_what_is_not_finite(position: Vector, rotation: Quaternion) -> None:
    found = Mocap("y", 1.0, (1.0, 2.0, 3.0)).pose(position, rotation)
    if found is not None:
        assert math.isfinite(found[1])
