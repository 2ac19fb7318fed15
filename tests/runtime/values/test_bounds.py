"""Capacities: what fits, what is refused from the network, how many bytes there can be."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from koordgen.runtime.net.layout import Layout
from koordgen.runtime.net.wire import Entry, Write
from koordgen.runtime.program.program import Variable
from koordgen.runtime.values.bounds import Blob, Bound, Cells, Distinct, Fixed, Many, Pairs, Parts, Rays, Text, fits
from koordgen.runtime.values.gridmap import GridMap
from koordgen.runtime.values.points import Grid, Opaque, Point, Scan

INT, POINT = Fixed(9), Fixed(28)


class Task(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    label: str = ""
    at: Point = Point()


TASK = Parts((Text(4), POINT), ("label", "at"))


@pytest.mark.parametrize(
    ("bound", "good", "bad", "flaw"),
    [
        (INT, 2**63 - 1, 2**63, "an int beyond 64 bits, which no robot may use"),
        (INT, -(2**63), -(2**63) - 1, "an int beyond 64 bits, which no robot may use"),
        (Fixed(28), Grid(2**63 - 1, 0, 1.0), Grid(0, 2**63, 1.0), "an int beyond 64 bits, which no robot may use"),
        (Text(4), "äö", "äöx", "a text of 5 bytes, beyond its `max 4`"),
        (Text(4), "", "\ud800", "a text that is not Unicode"),
        (
            Cells(4),
            GridMap(1.0, 0, 0, 2, 2, b"\0"),
            GridMap(1.0, 0, 0, 5, 1, b"\0\0"),
            "a map of 5 cells, beyond its `max 4`",
        ),
        (Cells(4), GridMap(), GridMap(1.0, 0, 0, 2, 2, b""), "a broken map"),
        (Rays(1), Scan((1.0,), (1.0,), 2.0), Scan((), (1.0, 2.0), 2.0), "a scan of 2 rays, beyond its `max 1`"),
        (Blob(2, "Ticket"), Opaque(b"12"), Opaque(b"123"), "a Ticket of 3 bytes, beyond its `max 2`"),
        (Many(2, INT), (1, 2), (1, 2, 3), "a list of 3 elements, beyond its `max 2`"),
        (Many(2, INT), (1, 2), (1, 2**63), "one with an int beyond 64 bits, which no robot may use"),
        (Many(2, Many(1, TASK)), ((Task(),),), ((Task("12345"),),), "one with a text of 5 bytes, beyond its `max 4`"),
        (Distinct(2, INT), (1, 2), (2, 1), "a set out of order"),
        (Distinct(2, INT), (), (1, 1), "a set out of order"),
        (Distinct(2, INT), (1, 2), (1, 2, 3), "a set of 3 elements, beyond its `max 2`"),
        (Pairs(2, INT, INT), ((1, 9), (2, 0)), ((1, 9), (1, 0)), "a map out of order"),
        (Pairs(2, INT, Text(1)), ((1, "a"),), ((1, "ab"),), "one with a text of 2 bytes, beyond its `max 1`"),
        (Many(3, Distinct(2, INT)), ((1,), ()), ((1,), (3, 2)), "one with a set out of order"),
    ],
)
def test_flaws(bound: Bound, good: Any, bad: Any, flaw: str) -> None:
    assert bound.flaw(good) == "" and fits(bound, good)
    assert bound.flaw(bad) == flaw and not fits(bound, bad)


SHARED = (
    Variable("ids", "allwrite", tuple[int, ...], Distinct(3, INT), lambda: ()),
    Variable("names", "allwrite", tuple[tuple[int, str], ...], Pairs(2, INT, Text(8)), lambda: ()),
    Variable("map", "allread", GridMap, Cells(16), GridMap),
    Variable("tasks", "allread", tuple[Task, ...], Many(2, TASK), lambda: ()),
)


def entry(**values: Any) -> Entry:
    names = [v.name for v in SHARED]
    writes = sorted((names.index(n), msgspec.msgpack.encode(v)) for n, v in values.items())
    return Entry(1, 0, 4, 4, writes=tuple(Write(i, msgspec.Raw(data)) for i, data in writes))


@pytest.mark.parametrize(
    "values",
    [
        {"ids": (2, 1)},
        {"ids": (1, 2, 3, 4)},
        {"names": ((1, "a"), (1, "b"))},
        {"names": ((1, "123456789"),)},
        {"map": GridMap(1.0, 0, 0, 4, 4, b"\0\0\0")},
        {"map": GridMap(1.0, 0, 0, 4, 4, b"\x02\0\0\0")},
        {"map": GridMap(1.0, 0, 0, 4, 5, bytes(5))},
        {"tasks": (("1", (0.0, 0.0, float("nan"))),)},
        {"tasks": (("1", (0.0, 0.0)), ("2",), ("3",))},
        {"tasks": (("1", (0.0, 0.0, 0.0), 4),)},
        {"ids": (1, 2), "names": ((1, 2),)},
    ],
)
def test_what_no_program_can_write_is_refused_from_the_network(values: dict[str, Any]) -> None:
    layout = Layout(SHARED, 3)
    assert layout.read(entry(**values)) is None


def test_what_a_program_wrote_is_read() -> None:
    layout = Layout(SHARED, 3)
    values = {
        "ids": (1, 5),
        "names": ((1, "a"), (2, "")),
        "map": GridMap(1.0, 0, 0, 4, 4, b"\3\1\0\0"),
        "tasks": (Task("a", Point(1, 2, 3)),),
    }
    written = Entry(1, 0, 4, 4, lock=0, writes=layout.written(values)[0])
    (event,) = layout.read(written) or ()
    assert event.values == list(enumerate(values.values()))
