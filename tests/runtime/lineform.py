"""LineForm as koordgen would generate it, written by hand, with an allwrite variable `last` that everyone writes."""

from __future__ import annotations

from typing import Any

from koordgen.runtime.program import Cell, Effects, Event, Frame, Port, Program, Slots, Variable
from koordgen.runtime.values import Point


class State:
    def __init__(self, frame: Frame) -> None:
        self.pid = frame.pid
        self.n_sys = frame.n_sys
        self.position: Point = frame.sensors["Motion.position"]
        self.reached: bool = frame.sensors["Motion.reached"]
        self.target: Cell[Point] = Cell(frame.actuators["Motion.target"])
        self.x: Slots[Point] = Slots(frame.shared["x"], frame.pid)
        self.last: Cell[int] = Cell(frame.shared["last"])
        self.count: int = frame.locals["count"]

    def effects(self, stopped: bool) -> Effects:
        shared: dict[str, Any] = {}
        actuators: dict[str, Any] = {}
        if self.x.written:
            shared["x"] = self.x.own
        if self.last.written:
            shared["last"] = self.last.value
        if self.target.written:
            actuators["Motion.target"] = self.target.value
        return Effects({"count": self.count}, shared, actuators, stopped)


def init(s: State) -> None:
    s.x.own = s.position
    s.last.value = s.pid


def guard(s: State) -> bool:
    return not (s.pid == s.n_sys - 1 or s.pid == 0)


def effect(s: State) -> None:
    s.target.value = (s.x[s.pid + 1] + s.x[s.pid - 1]) / 2
    s.x.own = s.position
    s.last.value = s.pid
    s.count += 1


PROGRAM = Program(
    name="lineform",
    source="lineform.koord",
    program_hash="00112233445566aa",
    interface_hash="aabbccddeeff0011",
    locals=(Variable("count", "local", int, lambda: 0),),
    shared=(
        Variable("x", "allread", Point, lambda: Point()),
        Variable("last", "allwrite", int, lambda: -1),
    ),
    ports=(
        Port("Motion.position", "sensor", Point),
        Port("Motion.reached", "sensor", bool),
        Port("Motion.target", "actuator", Point),
    ),
    init=init,
    events=(Event("TargetUpdate", 13, guard, effect),),
    begin=State,
    end=State.effects,
    file=__file__,
    lines={},
)
