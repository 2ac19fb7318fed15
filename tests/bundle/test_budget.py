"""The build's budget and the robot's must give the same verdict."""

from __future__ import annotations

import re
from typing import Any

import msgspec
import pytest

from koordgen.bundle.budget import check_budget, most_bytes, overhead
from koordgen.check import check
from koordgen.emit.program import WIRE_FORMAT, program_text
from koordgen.ir.decl import Program
from koordgen.runtime import wire
from koordgen.runtime.gridmap import GridMap
from koordgen.runtime.layout import Layout, TooLarge
from koordgen.runtime.program import Program as Generated
from koordgen.runtime.values import Grid, Opaque, Point, Pose, Scan
from koordgen.source import Source
from koordgen.syntax.parse import parse

EVENT = "E:\n  pre: True\n  eff: pass\n"


def program(points: int, others: str = "") -> Program:
    return checked("".join(f"allread: Point x{i}[N_SYS]\n" for i in range(points)) + others + EVENT)


def checked(text: str) -> Program:
    tree, found = parse(Source("a.koord", text))
    assert not found, found
    program, wrong = check(tree, Source("a.koord", text))
    assert program is not None, wrong
    return program


def generated(program: Program) -> Generated:
    scope: dict[str, Any] = {"__name__": "generated", "__file__": "a.py"}
    exec(compile(program_text(program), "a.py", "exec"), scope)
    found: Generated = scope["PROGRAM"]
    return found


def robots_verdict(program: Generated, n_sys: int) -> bool:
    try:
        Layout(program.shared, n_sys)
    except TooLarge:
        return False
    return True


def test_overhead_is_the_wires() -> None:
    assert [overhead(n) for n in range(1, wire.MAX_ROBOTS + 1)] == [
        wire.overhead(n) for n in range(1, wire.MAX_ROBOTS + 1)
    ]


def test_the_wire_format_is_the_hashed_one() -> None:
    assert WIRE_FORMAT == wire.WIRE_FORMAT


@pytest.mark.parametrize("n_sys", [1, 2, 5, 16, 60, 90, 128])
def test_both_give_the_same_verdict(n_sys: int) -> None:
    verdicts = set()
    for points in range(38):
        made = program(points, "allwrite:\n  int a\n  bool b\n  float c\n")
        fits = not check_budget(made, n_sys)
        assert fits == robots_verdict(generated(made), n_sys), points
        verdicts.add(fits)
    assert len(verdicts) == 2 or n_sys > 100, "both sides of the limit were met"


TYPES = """
def Task:
  Point target
  string label max 20
  List<int> steps max 17
extern type Ticket
extern fun stamp(Ticket t) -> Ticket
"""
VARIABLES = """allwrite:
  int i
  bool b
  float f
  Point p
  Pose pose
  Grid g
  string s max 31
  string t max 255
  string u max 256
  GridMap m max 399
  GridMap n max 4000
  Scan scan max 15
  List<Point> l max 15
  Queue<(int, bool)> q max 16
  Set<string> names max 3, 40
  Map<int, List<Point>> paths max 4, 7
  List<Task> tasks max 5
  Task task
  (int, string) pair max 12
  Ticket ticket
"""


def test_bytes_of_every_type_are_those_that_robots_count() -> None:
    program = checked(TYPES + VARIABLES + EVENT)
    robots = {v.name: v.bound.bytes for v in generated(program).shared}
    assert {v.name: most_bytes(v.type) for v in program.shared} == robots


def test_no_value_within_its_bound_is_longer() -> None:
    """The longest values there are, encoded."""
    text, point = "x" * 40, Point(0.1, 0.2, 0.3)
    far = -(2**63)
    longest: dict[str, object] = {
        "i": far, "b": True, "f": 0.1, "p": point, "pose": Pose(point, 0.1), "g": Grid(far, far, 0.1),
        "s": text[:31], "t": "x" * 255, "u": "x" * 256,
        "m": GridMap(0.1, far, far, 399, 1, bytes(100)), "n": GridMap(0.1, far, far, 4000, 1, bytes(1000)),
        "scan": Scan((0.1,) * 15, (0.1,) * 15, 0.1), "l": (point,) * 15, "q": ((far, True),) * 16,
        "names": (text,) * 3, "paths": ((far, (point,) * 7),) * 4, "tasks": ((point, text[:20], (far,) * 17),) * 5,
        "task": (point, text[:20], (far,) * 17), "pair": (far, text[:12]), "ticket": Opaque(bytes(256)),
    }  # fmt: skip
    for v in checked(TYPES + VARIABLES + EVENT).shared:
        length = len(msgspec.msgpack.encode(longest[v.name]))
        assert length <= most_bytes(v.type) <= length + 24, v.name  # a GridMap's window cannot be so large and so far


def test_the_message_has_the_arithmetic_and_the_place() -> None:
    (found,) = check_budget(program(40), 5)
    assert found.code == "B004"
    assert "up to 1306 bytes; with 5 robots a datagram of 1200 has room for 944" in found.message


def test_the_max_that_help_names_fits_and_one_more_does_not() -> None:
    source = "allread:\n  List<Point> path[N_SYS]MAX\n  int a[N_SYS]\n" + EVENT
    (found,) = check_budget(checked(source.replace("MAX", "")), 5)
    assert (found.span.line, "path alone takes up to 1795" in found.message) == (2, True)
    (most,) = re.findall(r"it fits with `max (\d+)`", found.help)
    assert not check_budget(checked(source.replace("MAX", f" max {most}")), 5)
    assert check_budget(checked(source.replace("MAX", f" max {int(most) + 1}")), 5)
