"""LineForm as koordgen would generate it, written by hand, with an allwrite variable `last` that everyone writes."""

from __future__ import annotations

from koordgen.runtime.bounds import Fixed
from koordgen.runtime.program import Cell, Event, Frame, Port, Program, Slots, Transaction, Variable
from koordgen.runtime.values import Point


class State(Transaction):
    def __init__(self, frame: Frame) -> None:
        super().__init__(frame)
        self.position: Point = frame.sensors["Motion.position"]
        self.reached: bool = frame.sensors["Motion.reached"]
        self.target: Cell[Point] = self.actuator("Motion.target")
        self.x: Slots[Point] = self.slots("x")
        self.last: Cell[int] = self.shared("last")
        self.count: Cell[int] = self.local("count")


def init(s: State) -> None:
    s.x.own = s.position
    s.last.value = s.pid


def guard(s: State) -> bool:
    return not (s.pid == s.n_sys - 1 or s.pid == 0)


def effect(s: State) -> None:
    s.target.value = (s.x[s.pid + 1] + s.x[s.pid - 1]) / 2
    s.x.own = s.position
    s.last.value = s.pid
    s.count.value += 1


PROGRAM = Program(
    name="lineform",
    source="lineform.koord",
    program_hash="00112233445566aa",
    interface_hash="aabbccddeeff0011",
    locals=(Variable("count", "local", int, Fixed(9), lambda: 0),),
    shared=(
        Variable("x", "allread", Point, Fixed(28), lambda: Point()),
        Variable("last", "allwrite", int, Fixed(9), lambda: -1),
    ),
    ports=(
        Port("Motion.position", "sensor", Point),
        Port("Motion.reached", "sensor", bool),
        Port("Motion.target", "actuator", Point, Fixed(28), Point),
    ),
    init=init,
    events=(Event("TargetUpdate", 13, guard, effect),),
    begin=State,
    file=__file__,
    lines={},
)
