"""Edits, and the upgrade of the 2020 dialect by those that the checker proposes."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from koordgen.cli import main
from koordgen.lang.analyze.program import check
from koordgen.lang.diagnostics import Diagnostic, Edit, InternalError
from koordgen.lang.format.upgrade import Checker, apply_edits, non_overlapping, upgraded
from koordgen.lang.source import Source, Span
from koordgen.lang.syntax.parse import parse

TEXT = "one two\nthree\n\nfour"


def edit(line: int, column: int, end_line: int, end_column: int, text: str) -> Edit:
    return Edit(Span(line, column, end_line, end_column), text)


OLD = """\
using Motion:
  actuators:
    pos target
  sensors:
    pos position
    boolean reached
allread: pos[] place
local:
  boolean moving = false # of 2020
  int[][] grid
  int k = 0
def fun nearer(pos a, pos b):
  if !(distance(a, b)<1.0)&&true:
    return midpoint(a, b)
  return pos3d(0,0,1)
init:
  place[pid] = Motion.position
Go:
  pre: !moving || Motion.reached
  eff:
    for i = 0, numAgents - 1:
      k = k + i
    moving = true
    Motion.target = nearer(Motion.position, midpoint(midpoint(Motion.position, pos3d(1,2,3)), Motion.position))
    place[pid] = Motion.position
"""
NEW = """\
using Motion:
  actuators:
    Point target
  sensors:
    Point position
    bool reached

allread: Point place[N_SYS]

local:
  bool moving = False  # of 2020
  List<List<int>> grid
  int k = 0

fun nearer(Point a, Point b) -> Point:
  if not (distance(a, b) < 1.0) and True:
    return ((a + b) / 2)
  return Point(0, 0, 1)

init:
  place[pid] = Motion.position

Go:
  pre: not moving or Motion.reached
  eff:
    for i in range(0, N_SYS - 1 + 1):
      k = k + i
    moving = True
    Motion.target = nearer(Motion.position, ((((Motion.position + Point(1, 2, 3)) / 2) + Motion.position) / 2))
    place[pid] = Motion.position
"""


def test_a_program_of_2020_is_upgraded_and_means_the_same(tmp_path: Path) -> None:
    path = tmp_path / "old.koord"
    path.write_text(OLD)
    assert main(["fmt", str(path)]) == 0
    assert "boolean moving = false  # of 2020" in path.read_text(), "only when asked"
    assert main(["fmt", "--upgrade", str(path)]) == 0
    assert path.read_text() == NEW
    assert main(["fmt", "--upgrade", "--check", str(path)]) == 0

    meanings = [check(parse(s)[0], s)[0] for s in (Source("old.koord", OLD), Source("old.koord", NEW))]
    assert meanings[0] is not None
    assert meanings[0] == meanings[1]


def test_edits_are_made_in_any_order() -> None:
    edits = [edit(1, 5, 1, 8, "2"), edit(4, 1, 4, 5, "vier"), edit(1, 1, 1, 4, ""), edit(2, 6, 4, 1, " und ")]
    wanted = " 2\nthree und vier"
    assert apply_edits(TEXT, edits) == apply_edits(TEXT, reversed(edits)) == wanted
    assert apply_edits(TEXT, []) == TEXT


def test_insertions_at_one_place_keep_their_order_and_touch_replacements() -> None:
    edits = [edit(1, 1, 1, 4, "1"), edit(1, 1, 1, 1, "("), edit(1, 1, 1, 1, "["), edit(1, 4, 1, 4, ")")]
    assert apply_edits(TEXT, edits) == "([1) two\nthree\n\nfour"
    assert apply_edits("", [edit(1, 1, 1, 1, "a")]) == "a"


def test_edits_that_overlap_are_refused() -> None:
    with pytest.raises(ValueError, match="line 1"):
        apply_edits(TEXT, [edit(1, 1, 1, 5, ""), edit(1, 4, 1, 8, "")])


def test_a_notes_edits_are_taken_whole_or_left() -> None:
    def note(*edits: Edit) -> Diagnostic:
        return Diagnostic("K050", "note", "", edits[0].span, edits=edits)

    first = edit(1, 1, 1, 4, "1")
    last = edit(4, 1, 4, 5, "4")
    notes = [note(first), note(edit(1, 3, 1, 5, ""), edit(2, 1, 2, 1, "no")), note(last)]
    assert non_overlapping(notes) == [first, last]


def fake_check(meaning: str = r"\s+") -> Checker:
    """A checker that proposes `true` -> `True`, and `T[]` -> `List<T>` one level at a time, as overlapping edits; two
    programs that differ in what `meaning` matches mean the same."""

    def check(tree: object, source: Source) -> tuple[object, list[Diagnostic]]:
        found = []
        for match in re.finditer(r"\btrue\b|\w+(?:<\w+>)?\[\]|\w+\[\]\[\]", source.text):
            span = source.span(*match.span())
            text = "True" if match[0] == "true" else f"List<{match[0][:-2]}>"
            found.append(Diagnostic("K050", "note", "", span, edits=(Edit(span, text),)))
        found.append(Diagnostic("K040", "warning", "", Span(1, 1, 1, 2), edits=(edit(1, 1, 1, 2, "wrong"),)))
        return re.sub(meaning, "", source.text), found

    return check


def test_the_checkers_edits_are_made_until_there_are_none() -> None:
    source = Source("a.koord", "local:\n  int[][] a\n  bool b = true and true\n")
    text = upgraded(source, fake_check(r"[\s\[\]<>]|List|(?i:true)")).text
    assert text == "local:\n  List<List<int>> a\n  bool b = True and True\n"


def test_an_upgrade_that_changes_the_meaning_is_found_out() -> None:
    with pytest.raises(InternalError, match=r"a\.koord would change its meaning"):
        upgraded(Source("a.koord", "local: bool b = true\n"), fake_check())


def test_an_upgrade_that_breaks_the_program_is_found_out() -> None:
    broken = Diagnostic("K050", "note", "", Span(1, 1, 1, 2), edits=(edit(1, 1, 1, 2, "("),))
    with pytest.raises(InternalError, match=r"a\.koord can no longer be parsed"):
        upgraded(Source("a.koord", "local: int b\n"), lambda tree, source: (None, [broken]))
