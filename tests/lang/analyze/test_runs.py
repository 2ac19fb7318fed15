"""An error about a run of a loop, against what happens: the executable meaning in fleets of up to six robots."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from koordgen.lang.analyze.program import check
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.step import initial, round_
from koordgen.lang.source import Source
from koordgen.lang.syntax.parse import parse

HEAD = """\
param int k = 2
param List<int> route = [4, 5]
allread: int x[N_SYS]
allwrite: int fog
local: int n
  bool on = {on}
  List<int> xs = [1, 2, 3]
Go:
  pre: {guard}
  eff:
"""
terms = st.sampled_from(["0", "1", "2", "k", "pid", "N_SYS", "len(xs)", "len(route)"])
sums = st.one_of(terms, terms, st.builds("{} {} {}".format, terms, st.sampled_from("+-"), st.sampled_from(["1", "k"])))
domains = st.one_of(
    st.builds("range({})".format, sums),
    st.builds("range({}, {})".format, sums, sums),
    st.builds("range({}, {}, {})".format, sums, sums, st.sampled_from(["-1", "2", "-2"])),
    st.just("ID"),
)
indices = st.one_of(
    st.sampled_from(["i", "i", "i + 1", "i - 1", "n", "i - pid", "i + k", "2 * i", "i // 2", "i % N_SYS", "n + i"])
)
before = st.sampled_from(
    ["pass", "pass", "n = i", "n = i + 1", "i -= 1", "n += 1", "xs.append(1)", "if on: n = 1",
     "if on: break", "if on: continue", "if i == 1: stop", "if on: i = 0", "xs = route"]
)  # fmt: skip
sites = st.sampled_from(
    ["x[pid] = x[{}]", "x[pid] = xs[{}]", "x[pid] = route[{}]", "on = on and xs[{}] > 0", "on = on or x[{}] > 0",
     "x[pid] = x[{}] if on else 0", "if x[{}] > 0: pass", "if on: x[pid] = x[{}]", "on = 9 < n < x[{}]"]
)  # fmt: skip
after = st.sampled_from(["pass", "pass", "if on: break", "stop", "n = 0", "i = 0", "xs = []"])


@settings(max_examples=250, deadline=None)
@given(
    st.booleans(),
    st.sampled_from(["True", "pid > 0", "N_SYS > 3", "k < N_SYS"]),
    domains,
    before,
    indices,
    sites,
    after,
)
def test_a_run_that_is_told_to_be_wrong_is_wrong_if_there_is_one(
    on: bool, guard: str, domain: str, before: str, index: str, site: str, after: str
) -> None:
    head = HEAD.format(on=on, guard=guard) + f"    for i in {domain}:\n      {before}\n"
    line = head.count("\n") + 1
    wrong, hidden, reached = (
        f"{head}      {text}\n      {after}\n"
        for text in (site.format(index), site.format(f"fog * fog + {index}"), "x[pid] = 1 // fog")
    )
    tree, unread = parse(Source("t.koord", wrong))
    assert not unread
    found = check(tree, Source("t.koord", wrong))[1]
    if any(d.code == "K030" and d.span.line == line and d.message.startswith("for i") for d in found):
        assert fails(hidden, line) or not fails(reached, line), wrong


def fails(text: str, line: int) -> bool:
    """Whether some robot of some fleet discards its event at a line."""
    tree, _ = parse(Source("t.koord", text))
    program, found = check(tree, Source("t.koord", text))
    assert program is not None, found
    for size in range(1, 7):
        _, steps = round_(program, initial(program, size)._replace(round=1))
        if any(isinstance(s.outcome, Discarded) and s.outcome.span.line == line for s in steps):
            return True
    return False
