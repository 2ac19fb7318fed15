"""What one writes by the habit of Python or C is met by a help that says how Koord has it."""

from __future__ import annotations

import pytest

from koordgen.lang.diagnostics import Diagnostic
from tests.lang.test_lang import found

PROGRAM = """\
using Motion:
  sensors: Point position
  actuators: Point target
local:
  int n
  float f
  bool b
{declared}
Go:
  pre: {guard}
  eff:
    {line}
"""


def sole(line: str = "n = 1", guard: str = "b", declared: str = "") -> Diagnostic:
    """The only thing found in a program with this line."""
    (only,) = found(PROGRAM.format(line=line, guard=guard, declared=declared))
    return only


@pytest.mark.parametrize(
    ("line", "code", "help"),
    [
        ("Motion.target = (1, 2, 3)", "K012", "Point(x, y, z)"),
        ("Motion.target = (n + 1, f, 3)", "K012", "Point(x, y, z)"),
        ("n = 1; f = 2", "K002", "each statement on a line of its own"),
        ("b = b & b", "K002", "write 'and'"),
        ("b = b | b", "K002", "write 'or'"),
        ("f = b ? 1 : 2", "K002", "a if condition else b"),
        ("n = n / 2", "K012", "'//'"),
        ("n /= 2", "K012", "'//'"),
        ("n = N_SYS / 2 + 1", "K012", "never converted to an int"),
        ("n = 1.5", "K012", "never converted to an int"),
        ("b = not n", "K012", "== 0"),
        ("n = len(f)", "K012", "len takes a List"),
        ("n = int(f)", "K010", "never converted to an int"),
        ("f = float(n)", "K010", "automatically"),
        ("f = dist(Motion.position, Motion.target)", "K010", "distance"),
        ("f = math.sqrt(2)", "K010", "write sqrt(...)"),
        ("f = 2 * math.pi", "K010", "write pi"),
        ("f = np.PI", "K010", "write pi"),
        ("f = math.tau", "K010", "write 2 * pi"),
        ("f = math.inf", "K010", "by their names alone"),
        ("print(n)", "K010", "Log.stdout <<"),
        ("b = n is None", "K001", "'=='"),
        ("n = None", "K010", "no empty value"),
        ("self.n = 1", "K010", "by its name alone"),
        ("n = max([1, 2])", "K014", "last(sorted(xs))"),
        ("b = any([b])", "K010", "a loop"),
        ("b = isinstance(n, int)", "K010", "declared type"),
        ("List<int> xs = list(range(3))", "K010", "[a, b]"),
        ("List<(int, int)> xs = sorted([(1, 2)])", "K012", "ints, floats or strings"),
        ("List<int> xs = [1, 2][:-1]", "K036", "len(...) - 1"),
        ("distance(Motion.position, Motion.target)", "K024", "x = distance(Motion.position, Motion.target)"),
        ("b = 'a'.upper() == 'A'", "K015", "join strings with '+'"),
        ("for k, v in {1: 2}: n += v", "K012", "{1: 2}.items()"),
    ],
)
def test_a_statement(line: str, code: str, help: str) -> None:
    told = sole(line)
    assert told.code == code
    assert help in told.help, told


def test_else_if_is_elif() -> None:
    told = sole("if b: n = 1\n    else if n == 1: n = 2")
    assert (told.code, told.help) == ("K001", "write 'elif'")


@pytest.mark.parametrize("declared", ["local: k = 3", "param k = 3", "local: k"])
def test_a_type_stands_before_the_name(declared: str) -> None:
    told = sole(declared=declared)
    assert told.code == "K001"
    assert "int k" in told.help, told


@pytest.mark.parametrize("declared", ["k = 3", "int k = 3", "Point home = Point(0, 0, 1)"])
def test_a_variable_is_declared_in_a_section(declared: str) -> None:
    told = sole(declared=declared)
    assert told.code == "K001"
    assert "under 'local:'" in told.help, told


def test_a_string_in_single_quotes_is_a_string() -> None:
    told = sole("f = 'fast'")
    assert (told.code, told.message) == ("K012", "f is a float, not a string")


@pytest.mark.parametrize("line", ["assert b", "del n", "global n"])
def test_what_has_no_type_is_told_once(line: str) -> None:
    assert sole(line).code == "K016"


def test_a_constant_zero_is_told_without_itself() -> None:
    assert sole("n = 5 // 0").message == "this divides by 0"
    assert sole("n = 5 // (2 - 2)").message == "this divides by (2 - 2), which is 0"


@pytest.mark.parametrize("name", ["inf", "sin"])
def test_no_far_fetched_guess(name: str) -> None:
    assert "did you mean" not in sole(f"f = {name}").help


def test_a_slot_that_may_be_nobodys_is_guarded() -> None:
    told = sole("Motion.target = x[n]", declared="allread: Point x[N_SYS]")
    assert (told.code, told.severity) == ("K031", "warning")
    assert "'if 0 <= n < N_SYS:'" in told.help
    guarded = PROGRAM.format(
        line="if 0 <= n < N_SYS:\n      Motion.target = x[n]", guard="b", declared="allread: Point x[N_SYS]"
    )
    assert not found(guarded)


def test_a_sized_local_is_a_list_from_then_on() -> None:
    assert sole("k[0] = 1", "len(k) > 0", "  int k[3]").help == "write List<int> k"


def test_a_letter_of_a_string_is_refused_once() -> None:
    assert sole("s[0] = 'a'", declared="  string s").code == "K022"


def test_a_stream_in_a_guard_is_refused_once() -> None:
    assert sole(guard="Log.out << 1", declared="using Log:\n  stream out").code == "K056"


def test_a_property_with_a_free_robot() -> None:
    assert "'forall i in ID:'" in sole(declared="invariant A: n[i] >= 0").help
