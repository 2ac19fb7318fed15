"""Induction over loops in the checker: its marks hold in random states, and seeded faults in it are found."""

from __future__ import annotations

from collections.abc import Callable
from random import Random

import pytest

from koordgen.lang.analyze.facts import induction
from koordgen.lang.analyze.facts.flow import Flow
from koordgen.lang.analyze.facts.induction import Candidate, LoopModel
from koordgen.lang.analyze.program import check
from koordgen.lang.diagnostics import InternalError
from koordgen.lang.ir import decl, expr, stmt
from koordgen.lang.ir.tree import walk
from koordgen.lang.semantics import exec
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.state import State
from koordgen.lang.semantics.step import enabled, execute, initial
from koordgen.lang.semantics.values import Value
from koordgen.lang.source import Source
from koordgen.lang.syntax.parse import parse
from tests.lang.analyze.random_loops import random_text

CERTAIN = {"K012", "K030", "K032", "K036"}  # what is wrong for certain is refused
ROBOTS = 3


def checked(text: str) -> tuple[decl.Program | None, set[str]]:
    """The program, and the codes of what was found in it."""
    source = Source("t.koord", text)
    tree, unread = parse(source)
    assert not unread, (unread, text)
    program, found = check(tree, source)
    return program, {each.code for each in found}


def proved(program: decl.Program) -> tuple[int, int]:
    """How many elements are read with an index that is proved, and with one that is not."""
    found = [node for node in walk((program.events, program.functions)) if isinstance(node, expr.At)]
    return sum(node.proved for node in found), sum(not node.proved for node in found)


def random_state(rng: Random, program: decl.Program) -> State:
    state = initial(program, ROBOTS)

    def values() -> dict[str, Value]:
        lists: dict[str, Value] = {}
        for name in ("xs", "ys"):
            lists[name] = tuple([rng.randrange(-2, 4) for _ in range(rng.randrange(4))])
        return {**lists, "n": rng.randrange(-2, 5)}

    return state._replace(robots=tuple([robot._replace(locals=values()) for robot in state.robots]))


def defeated(seed: int) -> tuple[int, str]:
    """How many indices of a random program are proved; its text, where a state defeats one of its marks."""
    text = random_text(seed)
    program, codes = checked(text)
    if program is None:
        assert codes & CERTAIN, (codes, text)
        return 0, ""
    rng, event = Random(-seed - 1), program.events[0]
    try:
        for turn in range(12):
            state = random_state(rng, program)
            try:
                if enabled(program, event, state, turn % ROBOTS):
                    execute(program, event.effect, state, turn % ROBOTS)
            except Discarded:
                pass
    except InternalError:
        return 0, text
    return proved(program)[0], ""


@pytest.fixture(autouse=True)
def short_loops(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exec, "MAX_TURNS", 60)


def run(seeds: range) -> int:
    found = [(seed, *defeated(seed)) for seed in seeds]
    wrong = [(seed, text) for seed, _, text in found if text]
    assert not wrong, wrong[0]
    return sum(count for _, count, _ in found)


def test_no_state_defeats_what_is_proved_in_loops() -> None:
    assert run(range(300)) > 100


@pytest.mark.slow
def test_no_state_defeats_what_is_proved_in_20000_programs() -> None:
    assert run(range(1000, 21000)) > 5000


def not_established(model: LoopModel, candidates: list[Candidate]) -> induction.ProvedCandidates:
    begins = model.first(model.before)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(induction, "_proved", lambda candidate, flow: flow is begins or HELD(candidate, flow))
        return KEPT(model._replace(first=lambda flow: begins), candidates)


def not_kept(model: LoopModel, candidates: list[Candidate]) -> induction.ProvedCandidates:
    return KEPT(model._replace(block=()), candidates)


def broken_off(candidate: Candidate, model: LoopModel, broken: list[Flow]) -> bool:
    return True


def nothing_in_loops(loop: stmt.For | stmt.While, flow: Flow) -> Flow:
    return flow


def no_continue(block: stmt.Block, flows: list[Flow], paths: induction._Paths) -> list[Flow]:
    left = FOLLOW(block, flows, paths)
    paths.turned.clear()
    return left


KEPT, FOLLOW, HELD = induction.proved_candidates, induction._paths_through, induction._proved


SHOWN = {
    "a counter below a length": "int k = 0\nwhile k < len(xs):\n  n += xs[k]\n  k += 1",
    "a counter unlike a length": "int k = 0\nwhile k != len(xs):\n  n += xs[k]\n  k += 1",
    "a counter from the end": "int k = len(xs) - 1\nwhile k >= 0:\n  n += xs[k]\n  k -= 1",
    "a counter that ends at a length":
        "int k = 0\nwhile k < len(xs):\n  if xs[k] == 3: break\n  k += 1\nif k < len(xs): n = xs[k]",
    "an invariant that a guard begins":
        "if n >= 0:\n  while n < len(xs):\n    invariant 0 <= n\n    int m = xs[n]\n    n += 1",
    "what is known before the loop":
        "if 0 <= n and n <= len(xs):\n  int m = n\n  while m < len(xs):\n    n = xs[m]\n    m += 1\n"
        "  while m > 0:\n    m -= 1\n    n = xs[m]",
    "the place of the greatest":
        "if len(xs) > 0:\n  int at = 0\n  for i in range(len(xs)):\n    if xs[i] > xs[at]: at = i\n  n = xs[at]",
    "the place of the first":
        "int at = -1\nfor i in range(len(xs)):\n  if xs[i] > 3:\n    at = i\n    break\nif at >= 0: n = xs[at]",
    "a list that grows with the loop":
        "List<int> ys\nfor i in range(len(xs)):\n  invariant len(ys) == i\n  ys.append(1)\n"
        "for i in range(len(xs)): n += ys[i]",
    "a count of elements": "int k = 0\nfor x in xs:\n  if x > 3: k += 1\nn = 7 // (k + 1)",
    "loops within one another":
        "int k = 0\nwhile k < len(xs):\n  int j = 0\n  while j < k:\n    n += xs[j] + xs[k]\n    j += 1\n  k += 1",
}  # fmt: skip


@pytest.mark.parametrize("block", SHOWN.values(), ids=SHOWN)
def test_an_index_that_a_loop_keeps_right_needs_no_check(block: str) -> None:
    program, codes = checked(function(block))
    assert program is not None and codes <= {"K035"}, codes
    assert proved(program)[1] == 0


OPEN = {
    "a step of two and the next element": "int k = 0\nwhile k < len(xs):\n  n += xs[k] + xs[k + 1]\n  k += 2",
    "a list that shrinks": "List<int> ys = xs\nint k = 0\nwhile k < len(ys):\n  ys.pop()\n  n += ys[k]\n  k += 1",
    "a counter that goes back": "int k = 0\nwhile k < len(xs):\n  n += xs[k]\n  k -= 1",
    "an invariant that does not hold at first": "while n < len(xs):\n  invariant n >= 0\n  n += xs[n] * 0 + 1",
    "an invariant that a turn breaks": "int k = 3\nwhile k < 9:\n  invariant k < len(xs)\n  n += xs[k]\n  k += 1",
    "what holds at the head but not at a break":
        "int k = 0\nwhile k < len(xs):\n  if xs[k] == 3:\n    k = -1\n    break\n  k += 1\nif k < len(xs): n = xs[k]",
    "the last value of a loop's variable":
        "int k = 0\nfor i in range(len(xs)):\n  invariant k <= i\n  k = i + 1\nn = xs[k]",
    "what a loop within it writes":
        "int k = 0\nwhile k < len(xs):\n  n += xs[k]\n  for x in xs: k -= 1\n  k += 1",
    "a turn that `continue` ends":
        "int k = 0\nwhile k < len(xs):\n  n += xs[k]\n  if n > 3:\n    k -= 1\n    continue\n  k += 1",
}  # fmt: skip


@pytest.mark.parametrize("block", OPEN.values(), ids=OPEN)
def test_an_index_that_a_loop_may_leave_wrong_is_reported(block: str) -> None:
    assert reported(block)


@pytest.mark.parametrize(
    ("name", "fault"),
    [
        ("proved_candidates", not_established),
        ("proved_candidates", not_kept),
        ("_holds_after_loop", broken_off),
        ("_after_inner_loop", nothing_in_loops),
        ("_paths_through", no_continue),
    ],
)
def test_a_seeded_fault_is_found(name: str, fault: Callable[..., object], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(induction, name, fault)
    monkeypatch.setattr("koordgen.lang.analyze.statements.proved_candidates", induction.proved_candidates)
    assert not all(reported(block) for block in OPEN.values())


def reported(block: str) -> bool:
    """Return whether an index of the block is wrong, or doubtful and checked at run time."""
    program, codes = checked(function(block))
    return bool(codes & {"K030", "K034"}) and (program is None or proved(program)[1] > 0)


def function(block: str) -> str:
    lines = "".join(f"  {line}\n" for line in block.split("\n"))
    head = "local:\n  List<int> all\n  int a\nfun f(List<int> xs, int first) -> int:\n  int n = first\n"
    return f"{head}{lines}  return n\nGo:\n  pre: a == 0\n  eff: a = f(all, a)\n"
