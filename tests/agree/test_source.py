"""Random programs as Koord text: parsed and checked again they mean the same, and what the checker proves holds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from random import Random
from typing import Any

import pytest

from koordgen.lang.analyze.program import check
from koordgen.lang.ir import decl as d
from koordgen.lang.ir import expr as e
from koordgen.lang.ir.tree import walk
from koordgen.lang.ir.verify import verify
from koordgen.lang.source import Source
from koordgen.lang.syntax.parse import parse
from tests.agree.both import Meant
from tests.agree.programs import N_SYS, random_program, random_state
from tests.agree.source import Unwritable, source

# What is wrong for certain is refused: indices, divisors and exponents that random programs chance upon.
CERTAIN = {"K012", "K030", "K032", "K036", "K057"}


def checked_again(program: d.Program, seen: Counter[str]) -> d.Program | None:
    """Return the program parsed from its text; None if it has no text, or is refused for a fault that always occurs."""
    try:
        text = source(program)
    except Unwritable:
        seen["no text"] += 1
        return None
    tree, unread = parse(Source("random.koord", text))
    assert not unread, (unread, text)
    again, found = check(tree, Source("random.koord", text))
    wrong = {x.code for x in found if x.severity == "error"}
    assert wrong <= CERTAIN, ([x for x in found if x.code in wrong - CERTAIN], text)
    seen["refused" if again is None else "right"] += 1
    return again


def parts(found: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return the parts of a program to compare; numbers of locks and lines of loop invariants may differ."""
    event, lock, outcome = found
    if isinstance(outcome, dict):
        outcome = {**outcome, "violated": len(outcome["violated"])}
    return event, lock is None, outcome


def run(seeds: Iterable[int]) -> Counter[str]:
    seen: Counter[str] = Counter()
    for seed in seeds:
        program = random_program(seed)
        again = checked_again(program, seen)
        if again is None:
            continue
        verify(again)
        seen["proved"] += len([n for n in walk(again) if isinstance(n, (e.At, e.SlotRead, e.Slice)) and n.proved])
        before, after = Meant(program), Meant(again)
        rng = Random(-seed - 1)
        for _ in range(2):
            state = random_state(rng, program)
            for pid in range(N_SYS):
                assert parts(after.event(state, pid)) == parts(before.event(state, pid)), (seed, pid, source(program))
    return seen


def test_text_means_what_its_ir_means() -> None:
    seen = run(range(30))
    assert seen["right"] > 20 and seen["proved"] > 250, seen


@pytest.mark.slow
def test_1000_texts_mean_what_their_ir_means() -> None:
    seen = run(range(5000, 6000))
    print(seen)
    assert seen["right"] > 750, seen
