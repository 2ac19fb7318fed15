"""The count of turns on robots, and that whatever takes turns can be interrupted."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest

from koordgen.build.emit.program import program_text
from koordgen.runtime.program.program import Fault, Frame, Program, enabled, no_ports, run
from koordgen.runtime.program.runner import Interrupting, Overrun
from koordgen.runtime.values import turns
from koordgen.runtime.values.turns import TooMuch, begin, made, minus, plus, product, turn
from tests.build.emit.generated import _module
from tests.lang.semantics.programs import compiled


@pytest.fixture
def ten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(turns, "MOST_TURNS", 10)
    begin()


def test_loops_within_loops_take_turns_of_one_count(ten: None) -> None:
    seen = []
    with pytest.raises(TooMuch):
        for i in turns.turns(range(100)):
            for j in turns.turns("ab"):
                seen.append((i, j))
    assert len(seen) == 6  # three turns of the outer loop with two of the inner one each, and the tenth turn


def test_a_loop_that_is_left_takes_no_more_turns(ten: None) -> None:
    for _ in range(5):
        for i in turns.turns(range(10**12)):
            if i == 1:
                break
    with pytest.raises(TooMuch):
        turn()


def test_when_all_turns_are_taken_none_comes_back_until_the_next_event(ten: None) -> None:
    for _ in range(2):
        with pytest.raises(TooMuch):
            while turn():
                pass
    begin()
    assert turn()


def test_what_is_made_takes_a_turn_for_each_hundred(ten: None) -> None:
    assert made((0,) * 99) == (0,) * 99
    made("a" * 1000)
    made("b" * 99)
    with pytest.raises(TooMuch):
        made("c" * 100)


def test_sizes() -> None:
    begin()
    edge = 1 << turns.MOST_BITS
    assert plus(edge - 1, 1 << 63) > edge  # what is small may be added
    assert minus(-edge + 1, 5) < -edge
    with pytest.raises(TooMuch, match="4096 bits"):
        plus(edge - 1, 1 << 64)
    with pytest.raises(TooMuch, match="4096 bits"):
        minus(-edge + 1, 1 << 64)
    assert product(1 << 2000, 1 << 2095) == edge >> 1
    with pytest.raises(TooMuch, match="4096 bits"):
        product(1 << 2000, 1 << 2096)
    with pytest.raises(TooMuch, match="100001 elements or characters"):
        made((0,) * 100_001)


def built(effect: str, guard: str = "True") -> Program:
    functions = "fun slow(int a) -> int:\n  int n = a\n  while n >= 0: n += 1\n  return n\n"
    lines = "\n".join(["    " + line for line in effect.split("\n")])
    text = f"{functions}local: int k = 3\nGo:\n  pre: {guard}\n  eff:\n{lines}\n"
    found: Program = _module("program", program_text(compiled(text))).PROGRAM
    return found


FRAME = Frame(0, 1, {"k": 3}, {}, {}, {}, no_ports)


@pytest.mark.parametrize(
    "effect", ["while True: pass", "for i in range(1000000000000): pass", "while k > 0: k += 1", "k = slow(k)"]
)
def test_the_rounds_timer_interrupts_what_generated_code_turns(
    effect: str, monkeypatch: pytest.MonkeyPatch, interrupting: Interrupting
) -> None:
    monkeypatch.setattr(turns, "MOST_TURNS", 10**15)
    program = built(effect)
    with pytest.raises(Overrun), interrupting(0.02):
        run(program, program.events[0].effect, program.begin(FRAME))


@pytest.fixture
def interrupting() -> Iterator[Interrupting]:
    before = signal.getsignal(signal.SIGALRM)
    yield Interrupting()
    signal.signal(signal.SIGALRM, before)


def test_a_guard_and_an_effect_have_turns_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(turns, "MOST_TURNS", 8)
    program = built("for i in range(8): k += 1", "sum([1, 2]) > 0")
    event = program.events[0]
    begin()
    for _ in range(8):
        turn()
    assert enabled(event, program.begin(FRAME))
    done = run(program, event.effect, program.begin(FRAME))
    assert not isinstance(done, Fault) and done.locals == {"k": 11}


def test_a_fault_names_the_line_of_the_loop() -> None:
    program = built("k = 4\nwhile True: pass")
    done = run(program, program.events[0].effect, program.begin(FRAME))
    assert isinstance(done, Fault)
    assert (done.line, done.reason) == (10, "it is not finished by the end of the round")
