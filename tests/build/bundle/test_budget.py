"""Size limits of the build and of the robot: both give the same verdict."""

from __future__ import annotations

import re
from typing import Any

import msgspec
import pytest

from koordgen.build.bundle.budget import (
    MOST_ENTRY,
    MOST_SHARED,
    check_budget,
    most_bytes,
    most_entry,
    most_init,
    most_store,
    overhead,
    store_bytes,
)
from koordgen.build.emit.program import WIRE_FORMAT, program_text
from koordgen.lang.analyze.program import check
from koordgen.lang.ir.decl import Program
from koordgen.lang.source import Source
from koordgen.lang.syntax.parse import parse
from koordgen.runtime.net import codec, layout, wire
from koordgen.runtime.net.layout import Layout, TooLarge
from koordgen.runtime.program.program import Program as Generated
from koordgen.runtime.values.gridmap import GridMap
from koordgen.runtime.values.points import Grid, Opaque, Point, Pose, Scan

EVENT = "E:\n  pre: True\n  eff: pass\n"


def program(shared: str) -> Program:
    return checked(f"allwrite:\n{shared}{EVENT}")


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
        codec.overhead(n) for n in range(1, wire.MAX_ROBOTS + 1)
    ]


def test_the_wire_format_is_the_hashed_one() -> None:
    assert WIRE_FORMAT == wire.WIRE_FORMAT


@pytest.mark.parametrize("n_sys", [1, 2, 5, 16, 60])
def test_both_give_the_same_verdict(n_sys: int) -> None:
    others = "  int i\n  bool b\n  float f\n  string s max 30000\n"
    room = most_entry(n_sys) - 38 - sum(5 + most_bytes(v.type) for v in program(others).shared) - 5
    capacity = room - (5 if room - 5 >= 1 << 16 else 3)
    for extra in (-1, 0, 1):
        made = program(f"{others}  string t max {capacity + extra}\n")
        fits = not check_budget(made, n_sys)
        assert fits == robots_verdict(generated(made), n_sys) == (extra <= 0), extra


@pytest.mark.parametrize("n_sys", [2, 5, 15, 16, 60, 90, 128])
def test_both_give_the_same_verdict_on_the_whole_store(n_sys: int) -> None:
    """Log entries fit here; the state transfer to a robot that rejoins is too long by one character."""
    source = "  int i\n  bool b\nallread:\n  float f[N_SYS]\n  string t[N_SYS] max MAX\n"
    large = program(source.replace("MAX", "130500" if n_sys < 60 else "9000"))
    (found,) = check_budget(large, n_sys)
    (most,) = re.findall(r"it fits with `max (\d+)`", found.help)
    for extra in (0, 1):
        made = program(source.replace("MAX", str(int(most) + extra)))
        assert (not check_budget(made, n_sys)) == robots_verdict(generated(made), n_sys) == (extra == 0), extra


def test_the_message_on_the_whole_store_has_the_arithmetic() -> None:
    (found,) = check_budget(checked("allread: string t[N_SYS] max 120000\nallwrite: int i\n" + EVENT), 5)
    assert (found.code, found.severity, found.span.line) == ("B004", "error", 1)
    assert found.message == (
        "all shared variables together take up to 600183 bytes; with 5 robots, a robot that rejoins can receive at "
        "most 239104 bytes; t alone takes up to 600026 bytes: 5 slots of 120005 bytes"
    )


@pytest.mark.parametrize("n_sys", [1, 15, 16, 128])
def test_no_store_is_longer_than_its_bound(n_sys: int) -> None:
    shared = program("  int i\n  string s max 300\nallread:\n  Point p[N_SYS]\n")
    bound = Layout(generated(shared).shared, n_sys)
    values = {"i": -(2**63), "s": "x" * 300, "p": (Point(0.1, 0.2, 0.3),) * n_sys}
    top = 2**53
    view = wire.View(top, top, (top,) * n_sys)
    state = wire.Snapshot(view, top, bound.pack(values), (top,) * n_sys, (2**32 - 1,) * n_sys)
    assert len(codec.encoder.encode(state)) == bound.snapshot_bytes == store_bytes(shared.shared, n_sys)


def init_writing(characters: int, written: str) -> Program:
    shared = f"allread: string t[N_SYS] max {characters}\nallwrite:\n  List<Point> way max 90\n  int i\n"
    return checked(f"{shared}local: string own max 3000\ninit:\n  i = 1\n{written}{EVENT}")


@pytest.mark.parametrize("n_sys", [2, 15, 16, 128])
def test_what_init_writes_goes_in_one_datagram(n_sys: int) -> None:
    write = "  if pid == 0:\n    t[pid] = own\n"
    *_, found = check_budget(init_writing(2000, write), n_sys)  # in the largest fleet all of it is too large as well
    assert (found.code, found.severity, found.span.line) == ("B004", "error", 1)
    assert found.message == (
        "writes of `init` to shared variables must fit into one datagram; they take up to 2060 bytes: 38 + 2008 for t "
        f"+ 14 for i; with {n_sys} robots there is room for {most_init(n_sys)} bytes"
    )
    assert found.help.endswith("give the variable its initial value in its declaration, or write it in an event")
    (most,) = map(int, re.findall(r"it fits with `max (\d+)`", found.help))
    if n_sys < 128:
        assert check_budget(init_writing(most, write), n_sys) == []
    assert check_budget(init_writing(most + 1, write), n_sys) != []
    assert check_budget(init_writing(2000, write), 1) == [], "there is nobody to be told"


@pytest.mark.parametrize("n_sys", [1, 2, 15, 16, 128])
def test_the_room_for_it_is_a_hellos(n_sys: int) -> None:
    top, token = 2**53, bytes(8)
    echoes = (wire.Echo(127, top, top),) * min(wire.MAX_ECHOES, n_sys)
    head = wire.Head(top, token, token, 127, token, token, top, top, top, echoes)
    hello = wire.Hello(head, 127, token, token, tuple(range(n_sys)), None, top, bytes(wire.RELEASE_SIZE))
    nothing = len(codec.encoder.encode(None))
    assert len(codec.encode(hello, bytes(32))) - nothing + most_init(n_sys) == wire.LIMIT


def test_a_list_that_init_spells_out_takes_what_it_holds() -> None:
    assert check_budget(init_writing(9, "  way = []\n"), 5) == []
    assert check_budget(init_writing(9, "  way = [Point(1, 2, 3), Point(1, 2, 3)]\n"), 5) == []
    (found,) = check_budget(init_writing(9, "  List<Point> w = []\n  way = w\n"), 5)
    assert "2528 for way" in found.message


def test_limits_are_the_layouts() -> None:
    assert (MOST_ENTRY, MOST_SHARED) == (layout.MOST_ENTRY, layout.MOST_SHARED)
    for n in range(1, wire.MAX_ROBOTS + 1):
        assert (most_entry(n), most_store(n)) == (layout.most_entry(n), layout.most_snapshot(n))


def test_more_shared_variables_than_a_entry_may_write() -> None:
    for count in (256, 257):
        made = program("".join(f"  bool b{i}\n" for i in range(count)))
        assert (not check_budget(made, 2)) == robots_verdict(generated(made), 2) == (count == 256)
    (found,) = check_budget(made, 2)
    assert "257 shared variables; at most 256" in found.message


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
    """Encodes the longest values of each type."""
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
    (found,) = check_budget(checked("allread: string text[N_SYS] max 140000\nallwrite: int i\n" + EVENT), 5)
    assert (found.code, found.severity, found.span.line) == ("B004", "error", 1)
    assert found.message == (
        "shared writes of one round take up to 140062 bytes; with 5 robots a round can send at most 131072 bytes; text "
        "alone takes up to 140005 bytes"
    )


def test_the_max_that_help_names_fits_and_one_more_does_not() -> None:
    source = "allread:\n  List<Point> path[N_SYS] max MAX\n  int a[N_SYS]\n" + EVENT
    (found,) = check_budget(checked(source.replace("MAX", "6000")), 5)
    (most,) = re.findall(r"it fits with `max (\d+)`", found.help)
    assert not check_budget(checked(source.replace("MAX", most)), 5)
    assert check_budget(checked(source.replace("MAX", str(int(most) + 1))), 5)


def test_without_a_capacity_to_lower_help_is_general() -> None:
    record = "def R:\n  string s max 140000\n" + "allwrite:\n  R r\n" + EVENT
    (found,) = check_budget(checked(record), 2)
    assert found.help.startswith("share fewer")
