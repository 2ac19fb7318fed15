"""What may leave a robot, and the values' form on the wire."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from koordgen.runtime.values.gridmap import GridMap, area
from koordgen.runtime.values.points import (
    INT_MAX,
    INT_MIN,
    Grid,
    NotANumber,
    Opaque,
    Point,
    Pose,
    Scan,
    distance,
    has_nan,
    no_nan,
    no_nan_in,
    transmissible,
)


class Task(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """As generated for a record."""

    name: str
    at: Point
    votes: tuple[tuple[int, float], ...]


class Nested(msgspec.Struct, frozen=True, array_like=True):
    task: Task
    tags: tuple[str, ...]


class Mutable(msgspec.Struct):
    x: int


class IntOfALibrary(int):
    pass


class FloatOfALibrary(float):
    pass


INF, NAN = float("inf"), float("nan")
TASK = Task("ein Weg", Point(1, 2, 3), ((0, 0.5), (1, 0.25)))
GOOD: list[Any] = [
    *(0, INT_MIN, INT_MAX, True, 0.0, -1e308, "", "Straße \U0001f916", (), b"\xff"),
    *(Point(), Pose(), Grid(), Scan((0.0, 0.1), (1.0, 2.0), 8.0), Opaque(), Opaque(b"\xc1")),
    *(GridMap(), area(Point(), Point(3, 3), 0.5), TASK, Nested(TASK, ("a", "b"))),
    *((1, (2.0, ("x", (True,)))), (Point(1, 2, 3),) * 64, IntOfALibrary(3), FloatOfALibrary(0.5)),
]
BAD: list[Any] = [
    *(INT_MIN - 1, INT_MAX + 1, 10**5000, INF, -INF, NAN, "\ud800", "caf\udce9", IntOfALibrary(2**63)),
    *(FloatOfALibrary("nan"), None, [], {}, set(), object(), Mutable(1), bytearray(b"x"), 1j),
    *(Point(NAN), Point(0, INF), Point(0, 0, NAN), Point(10**400), Pose(Point(0, 0, INF)), Pose(Point(), NAN)),
    *(Grid(2**63, 0, 1.0), Grid(0, 0, INF), Scan((0.0,), (INF,), 8.0), Scan((NAN,), (1.0,), 8.0), Scan((), (), INF)),
    *(GridMap(NAN), GridMap(1.0, 2**63), Task("\udfff", Point(), ()), Task("", Point(NAN), ())),
]


@pytest.mark.parametrize("value", GOOD, ids=lambda value: repr(value)[:40])
def test_what_may_leave_a_robot(value: Any) -> None:
    assert transmissible(value) is True
    assert transmissible((0, (value, value))) is True


@pytest.mark.parametrize("value", BAD, ids=lambda value: type(value).__name__)
def test_what_may_not_leave_a_robot_at_no_depth(value: Any) -> None:
    assert transmissible(value) is False
    assert transmissible((1, value, 2)) is False
    assert transmissible(((), ("a", (value,)))) is False
    assert transmissible(Nested(Task("", Point(), ((0, 1.0), (1, value))), ())) is False


def test_no_nesting_exhausts_the_stack() -> None:
    deep: Any = 1.0
    deeper: Any = NAN
    for _ in range(100_000):
        deep, deeper = (deep,), (deeper,)
    assert transmissible(deep)
    assert not transmissible(deeper)


@pytest.mark.parametrize(
    ("value", "form"),
    [
        (Point(1, 2, 3), [1, 2, 3]),
        (Pose(Point(1, 2, 3), 0.5), [[1, 2, 3], 0.5]),
        (Grid(-1, 2, 0.25), [-1, 2, 0.25]),
        (Scan((0.0, 0.1), (1.0, 2.0), 8.0), [[0.0, 0.1], [1.0, 2.0], 8.0]),
        (Opaque(b"\x01\x02"), [b"\x01\x02"]),
        (GridMap(0.5, -1, 2, 2, 1, b"\x0d"), [0.5, -1, 2, 2, 1, b"\x0d"]),
    ],
)
def test_values_are_short_arrays_on_the_wire(value: Any, form: list[Any]) -> None:
    encoded = msgspec.msgpack.encode(value)
    assert msgspec.msgpack.decode(encoded) == form
    assert msgspec.msgpack.decode(encoded, type=type(value)) == value
    with pytest.raises(msgspec.ValidationError):
        msgspec.msgpack.decode(msgspec.msgpack.encode([*form, 0]), type=type(value))
    with pytest.raises(AttributeError):
        setattr(value, value.__struct_fields__[0], 0)


def test_points_are_a_vector_space() -> None:
    p, q = Point(1, 2, 3), Point(0.5, -1, 4)
    assert (p + q, p - q, -p) == (Point(1.5, 1, 7), Point(0.5, 3, -1), Point(-1, -2, -3))
    assert p * 2 == 2 * p == p / 0.5 == Point(2, 4, 6)
    assert distance(Point(1, 1, 1), Point(3, 4, 7)) == 7


@pytest.mark.parametrize(
    "value", [NAN, (1.0, NAN), Point(NAN), Pose(Point(0, NAN)), ((1, (Point(NAN),)),), Scan((NAN,)), Grid(0, 0, NAN)]
)
def test_a_value_with_nan_in_it_is_not_compared(value: Any) -> None:
    assert has_nan(value)
    with pytest.raises(NotANumber, match="a comparison met NaN"):
        no_nan_in(value)


@pytest.mark.parametrize("value", [0.0, -INF, (1.0, "nan"), Point(INF), (), "nan", GridMap(), Opaque(b"\xc1")])
def test_infinity_may_be_compared(value: Any) -> None:
    assert no_nan_in(value) is value


def test_a_number_that_is_nan_is_not_compared() -> None:
    assert no_nan(INF) == INF
    with pytest.raises(NotANumber):
        no_nan(NAN)
