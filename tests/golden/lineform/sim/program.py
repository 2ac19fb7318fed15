"""lineform: the Koord program lineform.koord, compiled by koordgen 0.1.0.

The comment `# line 12` names a line of lineform.koord, in the folder of this file.
`s` is the state that an event reads and writes; `my_x` is a variable `x` declared in the event.
The next build overwrites this file: change the Koord program instead.
"""

from __future__ import annotations

from koordgen.runtime.program.program import (
    Cell, Event, Frame, Port, Program, Slots, Transaction, Variable
)
from koordgen.runtime.values.bounds import Fixed
from koordgen.runtime.values.points import Point


class State(Transaction):
    """State of one robot during one event of lineform, with the writes of the event so far."""

    def __init__(self, frame: Frame) -> None:
        super().__init__(frame)
        self.motion_position: Point = frame.sensors["Motion.position"]
        self.motion_target: Cell[Point] = self.actuator("Motion.target")
        self.shared_x: Slots[Point] = self.slots("x")


def init(s: State) -> None:
    s.shared_x.own = s.motion_position  # line 10


def guard_target_update(s: State) -> bool:
    """pre of TargetUpdate, lineform.koord:12"""
    return not (s.pid == s.n_sys - 1 or s.pid == 0)  # line 13


def effect_target_update(s: State) -> None:
    """eff of TargetUpdate, lineform.koord:12"""
    s.motion_target.value = (s.shared_x[s.pid + 1] + s.shared_x[s.pid - 1]) / 2.0  # line 15
    s.shared_x.own = s.motion_position  # line 16


# Line of this file: line of lineform.koord.
LINES: dict[int, int] = {28: 10, 33: 13, 38: 15, 39: 16}

PROGRAM = Program(
    name="lineform",
    source="lineform.koord",
    program_hash="d2d2942a7e80caab",
    interface_hash="dc2b1ffc690378b4",
    locals=(),
    shared=(
        Variable(  # line 7
            name="x",
            kind="allread",
            type=Point,
            bound=Fixed(bytes=28),
            initial=lambda: Point(0.0, 0.0, 0.0),
        ),
    ),
    ports=(
        Port(name="Motion.position", direction="sensor", type=Point, is_position=True),
        Port(
            name="Motion.target",
            direction="actuator",
            type=Point,
            bound=Fixed(bytes=28),
            unset=lambda: Point(),
            held="Motion.position",
        ),
    ),
    init=init,
    events=(
        Event(name="TargetUpdate", line=12, guard=guard_target_update, effect=effect_target_update),
    ),
    begin=State,
    file=__file__,
    lines=LINES,
    locks=(),
    library=None,
)
