"""The style, case by case: what is written and what the formatter makes of it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from koordgen.lang.format.arrange import arranged

SPACING = {
    "a=b+c": "a = b + c",
    "a  +=  1": "a += 1",
    "x[pid+1]": "x[pid + 1]",
    "x [ i ] = y[ j ]": "x[i] = y[j]",
    "a[ 1 : 2 ]": "a[1:2]",
    "a[:n] = a[n:]": "a[:n] = a[n:]",
    "a[f(i) : -1]": "a[f(i):-1]",
    "f ( a,b ,c )": "f(a, b, c)",
    "f(a,)": "f(a,)",
    "Task(target = p , id=-3)": "Task(target=p, id=-3)",
    "(a == b)": "(a == b)",
    "t=(1,2)": "t = (1, 2)",
    "m = { 1 : 2,a:b [ c:d ] }": "m = {1: 2, a: b[c:d]}",
    "s = {1,2}": "s = {1, 2}",
    "List<Point>path": "List<Point> path",
    "List < List <Point> >  path": "List<List<Point>> path",
    "Map<string,(int,Point)> m": "Map<string, (int, Point)> m",
    "(Point,Scan)  p": "(Point, Scan) p",
    "Task [ ] [ ]  all": "Task[][] all",
    "List<Point>[] all": "List<Point>[] all",
    "a<b": "a < b",
    "a = b<c and d>e": "a = b < c and d > e",
    "a<=b!=c": "a <= b != c",
    "a = - b": "a = -b",
    "a = -b- -c": "a = -b - -c",
    "a = not(b)": "a = not (b)",
    "a = b*-c**-d": "a = b * -c ** -d",
    "a = b if-c else(d)": "a = b if -c else (d)",
    "return-1": "return -1",
    "a = ! b&&c||!  d": "a = !b && c || !d",
    "a = b.c . d": "a = b.c.d",
    "a = position'in Rect(p' , q')": "a = position' in Rect(p', q')",
    "a = x'[i]'": "a = x'[i]'",
    "Log.stdout<<'a  b'<<\"c'\\\"d\"+e": "Log.stdout << 'a  b' << \"c'\\\"d\" + e",
    "a = b//c%d": "a = b // c % d",
    "a = forall i,j in ID:i==j": "a = forall i, j in ID: i == j",
    "a = (exists i in range( 0,n ):x[i])": "a = (exists i in range(0, n): x[i])",
    "a = b in[1,2]": "a = b in [1, 2]",
    "a = [- 1]+[ ]": "a = [-1] + []",
    "a = [[1] [0]]": "a = [[1][0]]",
    "a = max (b,c)": "a = max(b, c)",
    "for i=1,n: a": "for i = 1, n: a",
    "if a :b = c": "if a: b = c",
    "param List<Point> p  max  16,8=[ ]": "param List<Point> p max 16, 8 = []",
    "param List<int> p max(n+1)*2 = []": "param List<int> p max (n + 1) * 2 = []",
    "extern fun f ( List<Point> a [N_SYS],int b )->(A,B)": "extern fun f(List<Point> a[N_SYS], int b) -> (A, B)",
    "a = .5+1e3": "a = .5 + 1e3",
}


@pytest.mark.parametrize("written", SPACING)
def test_spacing(written: str) -> None:
    assert arranged(written) == SPACING[written] + "\n"


LINES = {
    "levels are two spaces each": (
        "Go:\n     pre: True\n     eff:\n        if a:\n           b\n        c\n",
        "Go:\n  pre: True\n  eff:\n    if a:\n      b\n    c\n",
    ),
    "a block on its header's line stays there": (
        "Go:\n  eff: a = 1\n     b = 2\n     if c: d\n     else: atomic:\n         e\n",
        "Go:\n  eff: a = 1\n    b = 2\n    if c: d\n    else: atomic:\n      e\n",
    ),
    "a blank line between sections, at most one within": (
        "\n\nlocal:\n\n  int a\n\n\n  int b\ninit:\n  pass\nGo:\n  pre: a\n\n\n\nStay:\n  pre: b\n\n\n",
        "local:\n  int a\n\n  int b\n\ninit:\n  pass\n\nGo:\n  pre: a\n\nStay:\n  pre: b\n",
    ),
    "a blank line between events of a priority block is kept, and one stands before and behind the block": (
        "A:\n  pre: a\npriority :\n\n    B:\n        pre: b\n        # c\n\n\n    C:\n        pre: c\nD:\n  pre: d\n",
        "A:\n  pre: a\n\npriority:\n  B:\n    pre: b\n    # c\n\n  C:\n    pre: c\n\nD:\n  pre: d\n",
    ),
    "sections of one line and one kind stand as they were": (
        "param int a = 1\nparam int b = 2\n\n\nparam int c = 3\n# d\nparam int d = 4\nlocal: int e\n",
        "param int a = 1\nparam int b = 2\n\nparam int c = 3\n# d\nparam int d = 4\n\nlocal: int e\n",
    ),
    "a longer section of the same kind does not": (
        "local: int a\nlocal: int b\n  int c\nlocal: int d\n",
        "local: int a\n\nlocal: int b\n  int c\n\nlocal: int d\n",
    ),
    "the blank line stands before the comments of a section": (
        "local:\n  int a\n# b\n\n# c\nlocal:\n  int d\n",
        "local:\n  int a\n\n# b\n\n# c\nlocal:\n  int d\n",
    ),
    "comments stand like the next line": (
        "Go:\n# a\n  pre: b\n      # c\n  eff:\n   # d\n     e\n# f\n     g\n",
        "Go:\n  # a\n  pre: b\n  # c\n  eff:\n    # d\n    e\n    # f\n    g\n",
    ),
    "comments at a block's end stay in it": (
        "Go:\n   eff:\n      a\n      # eff\n     # still\n   # go\n     # go\nStay:\n  pre: b\n      # end\n",
        "Go:\n  eff:\n    a\n    # eff\n  # still\n  # go\n  # go\n\nStay:\n  pre: b\n  # end\n",
    ),
    "two spaces before a comment": (
        "local: int a# b\ninit: c      #d   \n",
        "local: int a  # b\n\ninit: c  #d\n",
    ),
    "aligned comments stay aligned": (
        "local:\n  int a=1   # b\n  bool c    # d\n  int e # f\n  int g        # h\n\n  float i      # j\n",
        "local:\n  int a = 1  # b\n  bool c     # d\n  int e  # f\n  int g  # h\n\n  float i  # j\n",
    ),
    "comments go on below": (
        "local:     # a\n           # b\n  int c    # d\n           # e\n\n           # f\ninit: g\n",
        "local:   # a\n         # b\n  int c  # d\n         # e\n\n  # f\n\ninit: g\n",
    ),
    "lines within brackets": (
        "Go:\n eff:\n  a = f(b,\n g(c,\n    [\n  d,  # e\n\n\n # f\n]), h\n)\n  i\n",
        "Go:\n  eff:\n    a = f(b,\n        g(c,\n            [\n                d,  # e\n\n                # f\n"
        "        ]), h\n    )\n    i\n",
    ),
    "lines behind a backslash": (
        "Go:\n  eff: a = \\\n b + \\   \n   f(c, \\\n d)\n",
        "Go:\n  eff: a = \\\n      b + \\\n      f(c, \\\n          d)\n",
    ),
    "a backslash that continues nothing goes": (
        "local: int a \\\n\ninit: b \\\n # c\n\\\nGo:\n  \\\n  \\\n  eff: d \\\n  \\\n",
        "local: int a\n\ninit: b  # c\n\nGo:\n  eff: d\n",
    ),
    "lines that begin with and, or": (
        "Go:\n  pre:\n    a\n      # b\n    and c  # d\n      or e\n  eff: f\n",
        "Go:\n  pre:\n    a\n        # b\n        and c  # d\n        or e\n  eff: f\n",
    ),
    "tabs are spaces": ("local:\tint a\t#\tb\n", "local: int a  #\tb\n"),
    "comments alone": ("\n # a\n\n\n# b", "# a\n\n# b\n"),
    "nothing": ("\n  \n\n", ""),
}


@pytest.mark.parametrize("case", LINES)
def test_lines(case: str) -> None:
    written, wanted = LINES[case]
    assert arranged(written) == wanted
    assert arranged(wanted) == wanted


def test_the_pages_example_is_what_comes_out() -> None:
    page = (Path(__file__).parents[3] / "docs/reference/cli.md").read_text(encoding="utf-8")
    written, wanted = re.findall(r"```koord\n(.*?)```", page, re.DOTALL)
    assert arranged(written) == wanted
