"""lineform: the Koord program lineform.koord, compiled by koordgen 0.1.0.

Every statement names its line in lineform.koord, which stands beside this file. The next build writes this
file anew: change the Koord program, not this.
"""

from __future__ import annotations

from typing import Any

from koordgen.runtime.program import Cell, Effects, Event, Frame, Port, Program, Slots, Variable
from koordgen.runtime.values import Point


class State:
    """What one event of lineform sees on one robot, and what it has written so far."""

    def __init__(self, frame: Frame) -> None:
        self.pid = frame.pid
        self.n_sys = frame.n_sys
        self.motion_position: Point = frame.sensors["Motion.position"]
        self.motion_target: Cell[Point] = Cell(frame.actuators["Motion.target"])
        self.shared_x: Slots[Point] = Slots(frame.shared["x"], frame.pid)

    def effects(self, stopped: bool) -> Effects:
        """What the event did: all locals, and what it wrote of shared variables and actuators."""
        shared: dict[str, Any] = {}
        actuators: dict[str, Any] = {}
        if self.shared_x.written:
            shared["x"] = self.shared_x.own
        if self.motion_target.written:
            actuators["Motion.target"] = self.motion_target.value
        kept: dict[str, Any] = {}
        return Effects(kept, shared, actuators, stopped)


def init(s: State) -> None:
    s.shared_x.own = s.motion_position  # lineform.koord:10


def guard_target_update(s: State) -> bool:
    """pre of TargetUpdate, lineform.koord:12"""
    return not (s.pid == s.n_sys - 1 or s.pid == 0)  # lineform.koord:13


def effect_target_update(s: State) -> None:
    """eff of TargetUpdate, lineform.koord:12"""
    s.motion_target.value = (s.shared_x[s.pid + 1] + s.shared_x[s.pid - 1]) / 2.0  # lineform.koord:15
    s.shared_x.own = s.motion_position  # lineform.koord:16


# Line of this file -> line of lineform.koord.
LINES: dict[int, int] = {38: 10, 43: 13, 48: 15, 49: 16, 63: 7}

PROGRAM = Program(
    name="lineform",
    source="lineform.koord",
    program_hash="12ccde7e0051103e",
    interface_hash="7da5c1a40314d73e",
    locals=(
    ),
    shared=(
        Variable("x", "allread", Point, lambda: Point(0.0, 0.0, 0.0)),  # lineform.koord:7
    ),
    ports=(
        Port("Motion.position", "sensor", Point),
        Port("Motion.target", "actuator", Point),
    ),
    init=init,
    events=(
        Event("TargetUpdate", 12, guard_target_update, effect_target_update),
    ),
    begin=State,
    end=State.effects,
    file=__file__,
    lines=LINES,
)
