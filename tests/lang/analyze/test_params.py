"""Params that a build sets are a pass over the IR."""

from __future__ import annotations

import pytest

from koordgen.lang.analyze import params
from koordgen.lang.analyze.program import check
from koordgen.lang.ir import decl
from koordgen.lang.ir.printer import show
from koordgen.lang.ir.verify import verify
from koordgen.lang.source import Source
from koordgen.lang.syntax.parse import parse

PARAMS = """def Task:
  Point target
  int id = 3
  List<string> tags max 2, 4
param int laps = 1
param float margin = 0.5
param bool fast = False
param string name = "none"
param Pose start = Pose(Point(0, 0, 0), 0)
param Grid cell_ = Grid(1, 2, 0.5)
param List<Task> tasks max 2 = []
param Map<string, int> table = {}
param Map<(int, bool), int> odd = {}
param Set<int> some = {1}
param List<Point, int> pairs = []
Go:
  pre: True
  eff: pass
"""


def with_values(values: dict[str, params.Value]) -> decl.Program:
    source = Source("app.koord", PARAMS)
    checked, found = check(parse(source)[0], source)
    assert checked is not None, found
    return params.with_params(checked, values)


def test_a_build_sets_params_of_every_type() -> None:
    given: dict[str, params.Value] = {
        "laps": -4,
        "margin": 2,
        "fast": True,
        "name": "blue",
        "start": [[1, 2, 3], -0.5],
        "cell_": [1, -2, 0.25],
        "tasks": [{"target": [1, 2, 3], "tags": ["a", "b"]}, {"target": [0, 0, 0], "id": 4}],
        "table": {"a": 1, "b": -2},
        "odd": [[[1, True], 3]],
        "some": [3, 2],
        "pairs": [[[1, 2, 3], 4]],
    }
    program = with_values(given)
    verify(program)
    shown = [line.partition(" = ")[2] for line in show(program).splitlines() if line.startswith("param ")]
    no_tags = "List<string>{}"
    assert shown == [
        "(-4)",
        "2.0",
        "True",
        "'blue'",
        "Pose(Point(1.0, 2.0, 3.0), (-0.5))",
        "Grid(1, (-2), 0.25)",
        "List<Task>{Task{Point(1.0, 2.0, 3.0), 3, List<string>{'a', 'b'}}, "
        f"Task{{Point(0.0, 0.0, 0.0), 4, {no_tags}}}}}",
        "Map<string, int>{(string, int){'a', 1}, (string, int){'b', (-2)}}",
        "Map<(int, bool), int>{((int, bool), int){(int, bool){1, True}, 3}}",
        "Set<int>{3, 2}",
        "List<(Point, int)>{(Point, int){Point(1.0, 2.0, 3.0), 4}}",
    ]


def test_no_first_value_becomes_infinite() -> None:
    source = Source("app.koord", "param float p = 1\nlocal: float f = p * 1e308\nE:\n  pre: True\n  eff: pass\n")
    program = check(parse(source)[0], source)[0]
    assert program is not None
    assert params.with_params(program, {"p": 1.5}) != program
    with pytest.raises(params.BadParam, match="the initial value of f is too large for a float"):
        params.with_params(program, {"p": 2})


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("lap", 3, "no param 'lap'"),
        ("laps", 0.5, "param laps is of type int; 0.5"),
        ("laps", True, "param laps"),
        ("laps", 2**63, "param laps"),
        ("margin", float("nan"), "not a finite number"),
        ("margin", float("inf"), "param margin"),
        ("fast", 1, "param fast"),
        ("name", 3, "written \"...\""),
        ("start", [1, 2, 3], "[[x, y, z], yaw]"),
        ("cell_", [1.5, 2, 0.5], "param cell_[0] is of type int"),
        ("tasks", {"target": [1, 2, 3]}, "param tasks is of type List<Task>"),
        ("tasks", [{"goal": [1, 2, 3]}], "param tasks[0]: a Task has no field 'goal' (it has: target, id, tags)"),
        ("tasks", [{"target": [1, 2]}], "param tasks[0].target is of type Point, written [x, y, z]"),
        ("tasks", [{}, {}, {}], "param tasks has 3 elements, and at most 2 fit"),
        ("tasks", [{"tags": ["a", "b", "c"]}], "param tasks has 3 elements, and at most 2 fit"),
        ("tasks", [{"tags": ["\N{SNOWMAN}\N{SNOWMAN}"]}], "param tasks has 6 bytes, and at most 4 fit"),
        ("table", {1: 1}, "param table[0][0] is of type string"),
        ("odd", [[[1, True], 3], [[1, True], 4]], "param odd has an element that occurs twice"),
        ("some", [1, 1], "param some has an element that occurs twice"),
        ("pairs", [[[1, 2, 3]]], "param pairs[0] is of type (Point, int), written [Point, int]"),
    ],
)  # fmt: skip
def test_a_value_that_does_not_fit_its_param(name: str, value: params.Value, told: str) -> None:
    with pytest.raises(params.BadParam) as caught:
        with_values({name: value})
    assert told in str(caught.value)


@pytest.mark.parametrize(
    ("first", "value", "told"),
    [
        ("xs[2]", [1, 2], "the initial value of k has no value"),
        ("7 // xs[0]", [0, 0, 0], "the initial value of k has no value"),
        ("xs[0] * xs[1]", [2**40, 2**40, 0], "the initial value of k would be an int beyond 64 bits"),
    ],
)
def test_values_with_which_a_variable_would_begin_with_none_are_refused(
    first: str, value: params.Value, told: str
) -> None:
    text = f"param List<int> xs = [1, 2, 3]\nlocal: int k = {first}\nGo:\n  pre: True\n  eff: pass\n"
    source = Source("app.koord", text)
    checked, found = check(parse(source)[0], source)
    assert checked is not None, found
    assert params.with_params(checked, {"xs": [3, 2, 1]}).locals == checked.locals
    with pytest.raises(params.BadParam, match=told):
        params.with_params(checked, {"xs": value})


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("3", 3),
        ("-0.5", -0.5),
        ("True", True),
        ("1,2,-3", [1, 2, -3]),
        ("blue", "blue"),
        ('"3"', "3"),
        ('[{"id": 3}]', [{"id": 3}]),
        ("", ""),
    ],
)
def test_a_value_on_the_command_line(text: str, value: params.Value) -> None:
    assert params.parse_value(text) == value


def test_broken_json_on_the_command_line() -> None:
    with pytest.raises(params.BadParam, match="not JSON"):
        params.parse_value("[1, 2")
