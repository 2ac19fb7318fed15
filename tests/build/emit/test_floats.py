"""NaN checks in generated code: present for comparisons whose operands may be NaN, and for no others."""

from __future__ import annotations

import re

import pytest

from koordgen.build.emit.program import program_text
from koordgen.build.emit.property import properties_text
from tests.build.emit.generated import checked, in_one_line

HEAD = """
param float eps = 0.5
using Motion:
  sensors:
    Point position
    Scan scan
  actuators: Point target
  PathPlanner planner
allread: Point x[N_SYS]
allwrite: float shared
local:
  float f
  List<float> fs
  Point p
  bool on
extern fun weight(float a) -> float
fun bigger(float a, float b) -> bool:
  return a > b
E:
  pre: {guard}
  eff:
    {effect}
"""


def checks(effect: str, guard: str = "True") -> list[str]:
    """Return the checks for NaN in generated code, in the order of the text, without the explanation at its head."""
    text = in_one_line(program_text(checked(HEAD.format(guard=guard, effect=effect.replace("\n", "\n    ")))))
    return re.findall(r"no_nan\w*\([^()]*", text[text.index("def guard_e") :])


@pytest.mark.parametrize(
    "condition",
    [
        "f < eps", "f == f", "fs == [1.0, f]", "f in fs", "fs.count(f) == 1", "min(f, eps) == f", "sorted(fs) == fs",
        "f + eps < f * eps", "distance(Motion.position, x[pid]) < eps", "distance(x[0] + p, p) < eps",
        "(p + x[pid]) / 2 == p", "f / 3 > 2 * f", "abs(f) > sqrt(f)", "sum(fs) > shared", "sin(f) + cos(f) < 1",
        "p in Rect(x[pid], Motion.position)", "p in Ball(p - x[0], f * f)", "first(Motion.scan.ranges) < 1",
        "path_distance([p], [p]) < f", "clear([p], [], f)",
        "7 / len(fs) == f", "f % eps == 0", "2 * (f + eps) - f < 1", "max(f, eps) ** 2 > 1", "p.x == x[0].y",
    ],
)  # fmt: skip
def test_what_is_finite_after_one_operation_at_most_is_not_looked_at(condition: str) -> None:
    assert checks(f"on = {condition}", condition) == []


@pytest.mark.parametrize(
    ("condition", "wanted"),
    [
        ("f * f - f * f == 0", ["no_nan(s.local_f.value * s.local_f.value - s.local_f.value * s.local_f.value"]),
        ("eps < f * f * 0", ["no_nan(s.local_f.value * s.local_f.value * 0.0"]),
        ("f / eps / (f / eps) == 1", 1), ("(f + f) % f == 0", 1), ("(f + f) // f == 0", 1), ("(f + f) ** f == 0", 1),
        ("distance(p + p, p * f) < 1", 1), ("sum([f + f]) < 1", 1), ("atan2(f * f - f * f, 1) < 1", 1),
        ("weight(f) < weight(f)", 2), ("min(weight(f), 1) < 1", 1), ("[f, weight(f)] == fs", 1), ("weight(f) in fs", 1),
        ("sorted([weight(f)]) == fs", 1), ("fs.count(weight(f)) == 1", 1), ("fs.index(weight(f)) == 1", 1),
        ("p in Rect(p, Point(weight(f), 0, 0))", 1), ("p not in Ball(p, weight(f))", 1),
        ("(p, weight(f)) == (p, f)", 1),
    ],
)  # fmt: skip
def test_what_may_be_nan_is_looked_at(condition: str, wanted: list[str] | int) -> None:
    found = checks(f"on = {condition}")
    assert found == wanted or len(found) == wanted, found


@pytest.mark.parametrize(
    ("effect", "count"),
    [
        ("f = f * 10\non = f > f", 0), ("f = f * 10\non = f - f == 0", 1), ("f = f * f - f * f\non = f > 1", 1),
        ("on = f > 1\nf = weight(f)", 1), ("fs.append(weight(f))\non = fs == fs", 2),
        ("p = p * weight(f)\non = p == x[0]", 1),
        ("x[pid] = Point(weight(f), 0, 0)\non = x[0] == p", 1), ("shared = weight(f)\non = shared == f", 1),
        ("Motion.target = p * weight(f)\non = Motion.target == p", 1), ("float g = f\ng = weight(g)\non = g > 1", 1),
        ("on = p in Motion.planner(p)", 0), ("for g in fs: on = g > 1", 0), ("for g in [weight(f)]: on = g > 1", 1),
        ("float g = 1\nwhile g < 9: g = g * 2", 0), ("float g = 1\nfor i in ID: g = g * g * 0\non = g == 0", 1),
    ],
)  # fmt: skip
def test_variables_are_what_the_event_writes_to_them(effect: str, count: int) -> None:
    assert len(checks(effect)) == count
    assert checks("pass", "f == f and fs == fs and p == x[0]") == [], "a guard reads what was kept"


def test_parameters_of_functions_may_be_anything() -> None:
    assert "return no_nan(my_a) > no_nan(my_b)" in program_text(checked(HEAD.format(guard="True", effect="pass")))


def test_properties_read_what_is_finite_and_have_arrays_only_where_nan_decides_nothing() -> None:
    def text(formula: str) -> str:
        whole = HEAD.format(guard="True", effect="pass") + f"invariant P: {formula}\n"
        return properties_text(checked(whole)).partition("def invariant_p")[2]

    assert "no_nan" not in text("forall i in ID: f[i] * f[i] > eps")
    meeting = "f[i] * f[i] - f[i] * f[i] < 1"
    assert "no_nan(" in text(f"forall i in ID: {meeting}")
    assert "screening" in text(f"forall i in ID: {meeting}")
    assert "screening" in text(f"forall i in ID: f[i] < 1 or {meeting}")
    assert "screening" not in text(f"forall i in ID: {meeting} or f[i] < 1")
    assert "screening" not in text(f"exists i in ID: {meeting}")
    assert "screening" not in text(f"not (forall i in ID: {meeting})")
