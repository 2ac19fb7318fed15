"""What the checker says of indices, against what happens: the executable meaning in fleets of up to nine robots."""

from __future__ import annotations

import re

from hypothesis import given, settings
from hypothesis import strategies as st

from koordgen.lang.analyze.program import check
from koordgen.lang.ir.decl import Program
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.step import initial, round_
from koordgen.lang.source import Source
from koordgen.lang.syntax.parse import parse

leaves = st.sampled_from(["pid", "pid", "N_SYS", "k", "count", "0", "1", "2", "3"])
terms = st.recursive(
    leaves,
    lambda inner: st.one_of(
        st.builds("({} + {})".format, inner, inner),
        st.builds("({} - {})".format, inner, inner),
        st.builds("(2 * {})".format, inner),
        st.builds("({} // 2)".format, inner),
        st.builds("({} % N_SYS)".format, inner),
        st.builds("min({}, {})".format, inner, inner),
        st.builds("max({}, {})".format, inner, inner),
        st.builds("abs({})".format, inner),
    ),
    max_leaves=3,
)
comparisons = st.builds("{} {} {}".format, terms, st.sampled_from(["==", "!=", "<", "<=", ">", ">="]), terms)
conditions = st.recursive(
    comparisons | st.just("on"),
    lambda inner: st.one_of(
        st.builds("({} and {})".format, inner, inner),
        st.builds("({} or {})".format, inner, inner),
        st.builds("not ({})".format, inner),
    ),
    max_leaves=3,
)
statements = st.one_of(
    st.builds("count = {}".format, terms),
    st.builds("if {}: stop".format, conditions),
    st.builds("if {}: count = {}".format, conditions, terms),
    st.builds("on = {}".format, conditions),
)
HEAD = "param int k = 1\nallread: int x[N_SYS]\nallwrite: int fog\nlocal: int count = 2\n  bool on = True\n"


def outcomes(text: str) -> tuple[set[str], bool]:
    """The codes found about the last line, and whether some robot of some fleet fails at it."""
    source = Source("t.koord", text)
    tree, found = parse(source)
    assert tree is not None, found
    last = text.count("\n")
    codes = {d.code for d in check(tree, source)[1] if d.span.line == last}
    # An error leaves no program to run: the same one with the check left to run time, by a zero that only runs know.
    hidden = text.replace("= x[", "= x[fog * fog + ")
    tree, _ = parse(Source("t.koord", hidden))
    assert tree is not None
    program, found = check(tree, Source("t.koord", hidden))
    assert program is not None, found
    failed = False
    for size in range(1, 10):
        _, steps = round_(program, initial(program, size)._replace(round=1))
        failed |= any(isinstance(s.outcome, Discarded) and s.outcome.span.line == last for s in steps)
    return codes, failed


@settings(max_examples=150, deadline=None)
@given(conditions, st.lists(statements, max_size=3), terms)
def test_silence_means_that_no_index_fails(guard: str, before: list[str], index: str) -> None:
    body = "".join(f"    {line}\n" for line in [*before, f"x[pid] = x[{index}]"])
    codes, failed = outcomes(f"{HEAD}Go:\n  pre: {guard}\n  eff:\n{body}")
    if failed:
        assert codes & {"K030", "K031"}, "an index that can fail was passed in silence"


@settings(max_examples=150, deadline=None)
@given(conditions.filter(lambda c: "on" not in c and "count" not in c), terms.filter(lambda t: "count" not in t))
def test_an_error_means_that_a_robot_fails(guard: str, index: str) -> None:
    codes, failed = outcomes(f"{HEAD}Go:\n  pre: {guard}\n  eff:\n    x[pid] = x[{index}]\n")
    assert ("K030" in codes) <= failed or "K041" in codes


LISTS = """\
param List<int> route = {route}
param int k = 1
allread: int x[N_SYS]
allwrite: int turns
local: int count = {count}
  int out
  bool on = True
  List<int> xs = {xs}
  List<List<int>> rows = [[1], [], [4, 5]]
Go:
  pre: {guard}
  eff:
    int i = 0
    List<int> ys = [7, 8]
"""
lists = st.sampled_from(["xs", "xs", "ys", "ys", "route"])
read = st.one_of(lists, lists, st.just("rows[1]"))
changed = st.sampled_from(["xs", "ys"])
stepped = st.sampled_from(["i", "i", "count"])
sizes = st.builds("len({})".format, lists)
numbers = st.sampled_from(["i", "i", "count", "pid", "N_SYS", "k", "0", "1", "2", "x[pid]"])
sums = st.one_of(
    numbers,
    sizes,
    st.builds("{} {} {}".format, numbers, st.sampled_from("+-"), numbers),
    st.builds("{} - {}".format, sizes, st.sampled_from("12")),
    st.builds("min({}, {})".format, numbers, sizes),
)
tests = st.one_of(
    st.builds("{} {} {}".format, sums, st.sampled_from(["==", "!=", "<", "<=", ">", ">="]), sums),
    st.builds("0 <= {} < {}".format, st.sampled_from(["i", "count"]), sizes),
    st.builds("{} {} []".format, lists, st.sampled_from(["==", "!="])),
    st.builds("len({}) > {}".format, lists, st.sampled_from("01")),
    st.just("on"),
)
probes = st.one_of(
    st.builds("out = {}[{}]".format, read, st.one_of(st.sampled_from(["i", "i - 1", "count", "0", "1", "2"]), sums)),
    st.builds("out = {0}[len({0}) - 1]".format, read),
    st.builds("out = 7 % {}".format, sums),
    st.builds("out = x[{}]".format, sums),
    st.builds("out = len({}[{}:])".format, read, sums),
)
values = st.sampled_from(["[]", "[1, 2]", "ys + [3]", "xs", "ID"])
moves = st.one_of(
    st.builds("{} {}= {}".format, stepped, st.sampled_from(["", "+", "-"]), sums),
    st.builds("{} += {}".format, stepped, st.sampled_from(["1", "2", "-1"])),
    st.builds("{}.append({})".format, st.one_of(changed, st.just("rows[1]")), numbers),
    st.builds("if len({0}) > 0: {0}.pop()".format, changed),
    st.builds("if len({0}) > 0: {1} = {0}.pop()".format, changed, stepped),
    st.builds("{} = {}".format, changed, values),
    st.builds("xs = xs if {} else [1]".format, tests),
    st.builds("ys.insert(0, {})".format, numbers),
    st.sampled_from(["rows = [[], [2], []]", "x[pid] += 1", "rows[1] = ys", "rows[0] = []"]),
    st.builds("on = {}".format, tests),
)
Lines = list[str]


def block(head: str, *bodies: Lines) -> Lines:
    return [head, *(f"  {line}" for body in bodies for line in body)]


def loop(head: str, *bodies: Lines) -> Lines:
    """A loop that ends soon, whatever its body does."""
    return block(head, ["turns += 1", "if turns > 9: break"], *bodies)


def probe(*indices: str) -> st.SearchStrategy[Lines]:
    return st.builds(lambda xs, index: [f"out = {xs}[{index}]"], lists, st.sampled_from(indices))


simple = st.lists(st.one_of(probes, probes, moves), min_size=1, max_size=4)
blocks: st.SearchStrategy[Lines] = st.recursive(
    simple,
    lambda inner: st.one_of(
        st.builds(lambda a, b: [*a, *b], inner, inner),
        st.builds(lambda c, a: block(f"if {c}:", a), tests, inner),
        st.builds(lambda c, a, b: [*block(f"if {c}:", a), *block("else:", b)], tests, inner, inner),
        st.builds(lambda c: [f"if {c}: stop"], tests),
        st.builds(lambda xs, a, b: loop(f"for j in range(len({xs})):", a, b, a), lists, probe("j"), inner),
        st.builds(lambda a, b, c: loop(f"for j in range({a}, {b}):", ["i = j"], c), sums, sums, inner),
        st.builds(lambda a, b: loop("for j in ID:", a, ["out = x[j]"], b), inner, probe("j")),
        st.builds(lambda xs, a, b: loop(f"for j in {xs}:", ["i = j"], a, b), lists, probe("0"), inner),
        st.builds(lambda xs, a, b: loop(f"while i < len({xs}):", a, b, ["i += 1"]), lists, probe("i"), inner),
        st.builds(lambda c, a, b: loop(f"while {c}:", a, [f"if {c}: continue"], b), tests, inner, inner),
    ),
    max_leaves=4,
)


def renamed(lines: Lines) -> Lines:
    """Loops within loops need names of their own: every `j` gets the number of its loop."""
    around: list[tuple[int, str]] = []
    result = []
    for number, line in enumerate(lines):
        indent = len(line) - len(line.lstrip())
        while around and around[-1][0] >= indent:
            around.pop()
        if "for j in " in line:
            around.append((indent, f"j{number}"))
        result.append(re.sub(r"\bj\b", around[-1][1], line) if around else line)
    return result


def without_doubtful(text: str) -> tuple[Program | None, str]:
    """The program without the lines in which the checker sees that something may fail."""
    while True:
        source = Source("t.koord", text)
        tree, unread = parse(source)
        program, found = check(tree, source)
        assert not unread and {d.code for d in found if d.severity == "error"} <= {"K030", "K032", "K036"}, (
            text,
            found,
        )
        doubtful = {d.span.line for d in found if d.code in ("K030", "K031", "K032", "K033", "K034", "K036")}
        if not doubtful:
            return program, text
        lines = text.split("\n")
        for number in doubtful:
            line = lines[number - 1]
            assert not line.rstrip().endswith(":"), (text, found)
            lines[number - 1] = f"{line[: len(line) - len(line.lstrip())]}pass"
        text = "\n".join(lines)


@settings(max_examples=250, deadline=None)
@given(
    st.sampled_from(["[]", "[4]", "[4, 5, 6]"]),
    st.sampled_from(["-1", "0", "2"]),
    st.sampled_from(["[]", "[1]", "[1, 0, 2]"]),
    st.sampled_from(["True", "on", "0 <= count < len(xs)", "xs != []", "len(route) > 1 and count < len(route)"]),
    st.lists(blocks, min_size=1, max_size=3),
)
def test_a_program_without_warnings_never_fails(route: str, count: str, xs: str, guard: str, body: list[Lines]) -> None:
    """What is left when all that the checker doubts is taken away has a value in every fleet. The executable meaning
    raises InternalError where something proved has none."""
    head = LISTS.format(route=route, count=count, xs=xs, guard=guard)
    lines = renamed([line for lines in body for line in lines])
    program, text = without_doubtful(head + "".join(f"    {line}\n" for line in lines))
    assert program is not None
    for size in (1, 2, 5):
        _, steps = round_(program, initial(program, size)._replace(round=1))
        for step in steps:
            assert not isinstance(step.outcome, Discarded), (text, step.outcome)
