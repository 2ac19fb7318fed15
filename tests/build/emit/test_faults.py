"""Koord lines of faults: the line of the failed statement, or of the last write of a value that cannot be stored."""

from __future__ import annotations

import pytest

from koordgen.runtime.program.program import Fault
from tests.build.emit.generated import MOTION, load, step


def fault(text: str, functions: str = "") -> Fault:
    done = step(load(text, functions))
    assert isinstance(done, Fault), done
    return done


def line_of(text: str) -> int:
    """Return the line that ends in `# here`."""
    return next(number for number, line in enumerate(text.split("\n"), 1) if line.endswith("# here"))


EVENT = "E:\n  pre: True\n  eff:\n"
FUN = "fun half(int a, int b) -> int:\n  int c = 3\n  return c + a // b  # here\n"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("local:\n  List<int> xs\n  int i = 4\n" + EVENT + "    i = 0\n    i = xs[i]  # here\n", "index 0 is out"),
        ("local:\n  List<int> xs\n  int i = 4\n" + EVENT + "    i += 1\n    xs[i] = 2  # here\n", "index 5 is out"),
        ("local: int i\n" + FUN + EVENT + "    i = half(1, i)\n", "ZeroDivisionError"),
        ("local: int i\nE:\n  pre: 1 // i > 0  # here\n  eff: pass\n", "ZeroDivisionError"),
        ("local: Queue<int> q\n" + EVENT + "    q.pop()  # here\n", "index 0 is out of range: it is empty"),
        ("local: Set<int> q\n" + EVENT + "    q.remove(3)  # here\n", "3 is not in the set"),
        ("local:\n  int i = 3\n  int n = -1\n" + EVENT + "    i = i ** n  # here\n", "ValueError: an int has no"),
        ("allread: int x[N_SYS]\nlocal: int i = 7\n" + EVENT + "    i = x[i]  # here\n", "index 7 names no robot"),
        ("local:\n  string s\n  int n = -1\n" + EVENT + "    s = s[n:]  # here\n", "a negative index"),
        # At the event's end:
        (
            "local: int i = 3\n" + EVENT + "    for k in range(9):\n      i = i * i  # here\n    if i == 0: i = 1\n",
            "i would become an int beyond 64 bits, which no robot may use",
        ),
        (
            "allwrite: float f\nlocal: float big = 1e200\n" + EVENT + "    f = 1\n    f = big * big  # here\n",
            "f would become inf, which no robot may use",
        ),
        (
            "allread: int x[N_SYS]\nlocal: int i = 3\n" + EVENT + "    x[pid] = i ** 99  # here\n",
            "x would become an int beyond 64 bits",
        ),
        (
            "local: List<int> xs max 2\n"
            + EVENT
            + "    for i in range(3):\n      xs.append(i)  # here\n    int n = 1\n",
            "xs would become a list of 3 elements, beyond its `max 2`",
        ),
        (
            "allwrite: string s max 4\n" + EVENT + '    s = "ab"\n    s = s + "äö"  # here\n',
            "s would become a text of 6 bytes, beyond its `max 4`",
        ),
        (
            "allwrite: Map<int, List<int>> m max 2, 1\n" + EVENT + "    m[1] = [1]\n    m[2] = [1, 2]  # here\n",
            "m would become one with a list of 2 elements, beyond its `max 1`",
        ),
        (
            "local: GridMap m max 8\n" + EVENT + "    m = GridMap(Point(0,0,0), Point(3,3,0), 1)  # here\n",
            "m would become a map of 9 cells, beyond its `max 8`",
        ),
        (
            MOTION + "local: float z = 1e300\n" + EVENT + "    Motion.path = [Point(0, 0, z * z)]  # here\n",
            "Motion.path would become (Point(x=0.0, y=0.0, z=inf),), which no robot may use",
        ),
        (
            MOTION + "local: List<Point> p\n" + EVENT + "    p = Motion.planner(Point(0, 0, 0))  # here\n",
            "LookupError: nothing serves",
        ),
    ],
)
def test_a_fault_names_its_line(text: str, reason: str) -> None:
    found = fault(text)
    assert found.reason.startswith(reason), found
    assert (found.file, found.line) == ("a.koord", line_of(text))


EXTERN = """extern fun f(int a) -> int:
  requires: a < 5
  ensures: result > a
fun g(int a) -> int:
  return f(a) + 1  # here
local: int i = 1
""" + EVENT + "    i = g(i)\n"  # fmt: skip


@pytest.mark.parametrize(
    ("functions", "reason"),
    [
        ("def f(a): return 3.5", "f returned 3.5, not an int"),
        ("def f(a): return True", "f returned True, not an int"),
        ("def f(a): return None", "f returned None, not an int"),
        ("def f(a): return a", "f returned 1, which breaks its postcondition (line 3)"),
        ("def f(a): raise ValueError('no such thing')", "f raised ValueError: no such thing"),
        ("def f(a): raise SystemExit(3)", "f raised SystemExit: 3"),
        ("def f(a): raise KeyboardInterrupt", "f raised KeyboardInterrupt: "),
        ("def f(a, b): return 1", "f raised TypeError: f() missing 1 required"),
        ("def f(a): return f(a)", "f raised RecursionError"),
        ("class Odd:\n  def __repr__(self): raise ValueError\ndef f(a): return Odd()", "f returned <Odd instance"),
        ("class Odd(Exception):\n  def __str__(self): raise ValueError\ndef f(a): raise Odd", "f raised Odd"),
        ("g = 1", "a_functions.py has no f"),
    ],
)
def test_a_fault_in_an_extern_function_names_the_line_of_its_call(functions: str, reason: str) -> None:
    found = fault(EXTERN, functions)
    assert found.reason.startswith(reason), found
    assert found.line == line_of(EXTERN)


def test_what_an_extern_function_requires_is_checked_before_the_call() -> None:
    found = fault(EXTERN.replace("i = 1", "i = 5"), "def f(a): raise ValueError")
    assert found.reason == "f was called although its precondition (line 2) does not hold"


def test_functions_that_are_not_there() -> None:
    assert fault(EXTERN).reason.startswith("a_functions.py cannot be imported: ModuleNotFoundError")


def test_a_long_reason_is_cut() -> None:
    assert len(fault(EXTERN, "def f(a): raise ValueError('x' * 100000)").reason) < 400
