"""Size checks in generated code: present for values that may grow, absent for values that always stay small."""

from __future__ import annotations

import pytest

from koordgen.build.emit.program import program_text
from tests.lang.semantics.programs import compiled


def emitted(expression: str, type_: str = "int") -> str:
    """Return the Python text of an expression that is assigned to a local variable."""
    found = compiled(
        f"local:\n  int k\n  int n\n  string s\n  List<int> xs\n  {type_} out\n"
        f"Go:\n  pre: True\n  eff: out = {expression}\n"
    )
    line = next(line for line in program_text(found).split("\n") if line.strip().startswith("s.local_out.value ="))
    return line.split(" = ", 1)[1].split("  #")[0]


@pytest.mark.parametrize(
    ("expression", "python"),
    [
        ("k + 1", "s.local_k.value + 1"),
        ("k - pid", "s.local_k.value - s.pid"),
        ("2 * pid + 1", "2 * s.pid + 1"),
        ("(pid + k) % N_SYS", "(s.pid + s.local_k.value) % s.n_sys"),
        ("k + n", "plus(s.local_k.value, s.local_n.value)"),
        ("k - n", "minus(s.local_k.value, s.local_n.value)"),
        ("k * 2", "product(s.local_k.value, 2)"),
        ("len(xs) * len(s)", "len(s.local_xs.value) * len(s.local_s.value)"),
        ("sum(xs)", "checked(sum(looked(s.local_xs.value)))"),
        ("sum([k, 3])", "checked(sum((s.local_k.value, 3)))"),
    ],
)
def test_ints(expression: str, python: str) -> None:
    assert emitted(expression) == python


def test_floats_need_no_look() -> None:
    assert emitted("(k + 0.5) * n", "float") == "(float(s.local_k.value) + 0.5) * float(s.local_n.value)"


def test_texts_and_lists() -> None:
    assert emitted('"a" + "b"', "string") == '"a" + "b"'
    assert emitted("s + s", "string") == "made(s.local_s.value + s.local_s.value)"
    assert emitted("[1] + [2]", "List<int>") == "(1,) + (2,)"
    assert emitted("xs + [k]", "List<int>") == "made(s.local_xs.value + (s.local_k.value,))"
