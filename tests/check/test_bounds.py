"""What the checker says of indices, against what happens: the executable meaning in fleets of up to nine robots."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from koordgen.check import check
from koordgen.semantics.eval import Discarded
from koordgen.semantics.step import initial, round_
from koordgen.source import Source
from koordgen.syntax.parse import parse

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
