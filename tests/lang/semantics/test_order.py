"""Order of events: which events the language allows in a round, and which of these rounds agents take."""

from __future__ import annotations

from itertools import product

import pytest

from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.relations import choices, post, rounds
from koordgen.lang.semantics.state import State
from koordgen.lang.semantics.step import initial, round_, run_init
from tests.lang.semantics.priorities import ranked
from tests.lang.semantics.programs import compiled
from tests.verify.explore.random_programs import LEVELS

ORDERED = """
allread: int x[N_SYS]
local:
  int a
  List<int> xs
priority:
  Stop:
    pre: {stop}
    eff: a = 9
  Go:
    pre: {go}
    eff: a = 1
Wait:
  pre: True
  eff: a = 5
"""


def allowed(text: str) -> set[str]:
    """The events that robot 0 of two may run in round 1."""
    program = compiled(text)
    state, _ = run_init(program, initial(program, 2))
    return {step.event for step in choices(program, state, 0) if step.event is not None}


def test_an_event_runs_only_where_earlier_guards_of_its_block_are_false() -> None:
    assert allowed(ORDERED.format(stop="a == 0", go="True")) == {"Stop", "Wait"}
    assert allowed(ORDERED.format(stop="a == 1", go="True")) == {"Go", "Wait"}


def test_an_earlier_guard_without_a_value_blocks() -> None:
    assert allowed(ORDERED.format(stop="xs[0] == 1", go="True")) == {"Wait"}


def test_an_earlier_guard_is_read_at_the_round_s_start() -> None:
    program = compiled("""
allwrite: int sum
local: bool other
priority:
  First:
    pre: sum > 0
    eff: atomic:
      sum += 10
  Second:
    pre: True
    eff: atomic:
      sum += 1
""")
    state, _ = run_init(program, initial(program, 2))
    after = {end.store.cells["sum"] for end in post(program, state, (0, 1))}
    assert after == {0, 1, 2, 11}, "what robot 0 has written enables First, and does not block Second"
    state = after_one(program, state)
    assert {end.store.cells["sum"] for end in post(program, state, (0, 1))} == {1, 11, 21}


def after_one(program: object, state: State) -> State:
    return next(e for e in rounds(program, state) if e.store.cells["sum"] == 1)  # type: ignore[arg-type]


def test_blocks_do_not_order_one_another() -> None:
    text = (
        ORDERED.format(stop="a == 0", go="True")
        + "priority:\n  Late:\n    pre: a == 0\n    eff: a = 7\n  Later:\n    pre: True\n    eff: a = 8\n"
    )
    assert allowed(text) == {"Stop", "Wait", "Late"}


@pytest.mark.parametrize("seed", range(40))
def test_the_round_of_agents_is_a_round_of_the_language(seed: int) -> None:
    program = compiled(ranked(seed))
    for levels in product(LEVELS, repeat=2):
        state, _ = run_init(program, initial(program, 2, [{"Dev.level": level} for level in levels]))
        for _ in range(2):
            after, steps = round_(program, state)
            assert not any(isinstance(step.outcome, Discarded) for step in steps)
            assert after in rounds(program, state)
            state = after


def test_random_blocks_take_choices_away() -> None:
    taken = 0
    for seed in range(20):
        program = compiled(ranked(seed))
        free = program_without_blocks(ranked(seed))
        state, _ = run_init(program, initial(program, 2, [{"Dev.level": 1}] * 2))
        some, every = ({c.event for c in choices(p, state, 0)} for p in (program, free))
        assert some <= every
        taken += some < every
    assert taken >= 3


def program_without_blocks(text: str):  # type: ignore[no-untyped-def]
    from koordgen.lang.node import replace

    program = compiled(text)
    return replace(program, events=tuple(replace(event, priority=None) for event in program.events))
