"""Every state that a model can be in, breadth first: the first course that breaks a property is a shortest one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from time import perf_counter

from tests.model.protocol import Protocol
from tests.model.state import State, Violation

BEGIN = State()


@dataclass
class Found:
    states: int = 0
    steps: int = 0
    seconds: float = 0.0
    complete: bool = False
    violation: str = ""
    course: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        end = "complete" if self.complete else "cut short"
        head = f"{self.states} states, {self.steps} steps, {self.seconds:.1f} s, {end}"
        return "\n".join([head, *self.course, self.violation]).rstrip()


def explore(
    protocol: Protocol,
    most: int = 10_000_000,
    judge: Callable[[State, int], None] = lambda state, index: None,
    start: State = BEGIN,
) -> Found:
    """All states from `start` on, at most so many. `judge` looks at each and raises Violation."""
    began = perf_counter()
    known = {start: 0}
    states = [start]
    parents: list[tuple[int, str]] = [(-1, "")]
    found = Found()
    at = 0
    label = ""
    try:
        while at < len(states) and len(states) < most:
            state = states[at]
            label = ""
            judge(state, at)
            label = "(a next step)"
            for label, after in protocol.steps(state):
                found.steps += 1
                if after not in known:
                    known[after] = len(states)
                    states.append(after)
                    parents.append((at, label))
            at += 1
        found.complete = at == len(states)
    except Violation as violation:
        found.violation = str(violation)
        course = []
        while at > 0:
            at, words = parents[at]
            course.append(words)
        found.course = course[::-1]
    found.states, found.seconds = len(states), perf_counter() - began
    return found
