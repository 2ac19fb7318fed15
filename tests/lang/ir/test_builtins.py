"""Every built-in function of the table has what CONTRIBUTING.md lists: a meaning, generated code, exactness, a page."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from koordgen.lang.ir.builtins import FUNCTIONS, METHODS, UPDATE_SIGNATURES
from koordgen.lang.ir.types import FLOAT
from koordgen.lang.semantics.builtins import MEANINGS
from koordgen.lang.semantics.exact import ROUNDING
from koordgen.runtime.program.program import Effects
from tests.build.emit.generated import load, step
from tests.lang.semantics.programs import event, local

PAGE = (Path(__file__).parents[3] / "docs/reference/language.md").read_text(encoding="utf-8")
SUMS = {"sum"}  # whose meaning depends on the type of the elements
# Functions with a float in their result that are exact on exact numbers: they choose, negate or put together.
EXACT = {"abs", "min", "max", "Point", "Pose", "Grid", "Rect", "Ball"}
OF_FLOATS = [name for name, (one, *_) in FUNCTIONS.items() if set(one.args) == {FLOAT} and one.result == FLOAT]


@pytest.mark.parametrize("name", sorted({*FUNCTIONS, *[n for _, n in METHODS], *UPDATE_SIGNATURES} - SUMS))
def test_a_builtin_has_a_meaning(name: str) -> None:
    assert name in MEANINGS


@pytest.mark.parametrize("name", OF_FLOATS)
def test_generated_code_computes_what_the_semantics_does(name: str) -> None:
    arguments = ", ".join(["0.6", "0.8"][: len(FUNCTIONS[name][0].args)])
    text = f"local:\n  float f = 0.0\n{event(f'f = {name}({arguments})')}"
    done = step(load(text))
    assert isinstance(done, Effects), done
    assert done.locals["f"] == local(text, "f")


@pytest.mark.parametrize("name", OF_FLOATS)
def test_a_function_of_floats_is_known_to_round(name: str) -> None:
    """The attack on proofs computes exactly: what rounds must not pass for exact."""
    assert name in ROUNDING | EXACT


@pytest.mark.parametrize("name", sorted({*FUNCTIONS, *[n for _, n in METHODS]}))
def test_a_builtin_stands_on_the_page(name: str) -> None:
    assert re.search(rf"\b{name}\b", PAGE)
