"""kitchen: the Koord program kitchen.koord, compiled by koordgen 0.1.0.

Every statement names its line in kitchen.koord, which stands beside this file. The next build writes this
file anew: change the Koord program, not this.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

from koordgen.runtime.program import Cell, Effects, Event, Frame, Port, Program, Slots, Stopped, Variable
from koordgen.runtime.values import Point, distance

PARAM_MARGIN: float = 0.5  # kitchen.koord:2
PARAM_LAPS: int = 3  # kitchen.koord:3
PARAM_HOME: Point = Point(1.0, -2.0, 0.5)  # kitchen.koord:4


class State:
    """What one event of kitchen sees on one robot, and what it has written so far."""

    def __init__(self, frame: Frame) -> None:
        self.pid = frame.pid
        self.n_sys = frame.n_sys
        self.motion_position: Point = frame.sensors["Motion.position"]
        self.motion_reached: bool = frame.sensors["Motion.reached"]
        self.motion_target: Cell[Point] = Cell(frame.actuators["Motion.target"])
        self.shared_x: Slots[Point] = Slots(frame.shared["x"], frame.pid)
        self.shared_class: Slots[int] = Slots(frame.shared["class"], frame.pid)
        self.shared_lowest: Cell[float] = Cell(frame.shared["lowest"])
        self.shared_done: Cell[bool] = Cell(frame.shared["done"])
        self.local_count: int = frame.locals["count"]
        self.local_level: float = frame.locals["level"]
        self.local_on: bool = frame.locals["on"]
        self.local_last: Point = frame.locals["last"]

    def effects(self, stopped: bool) -> Effects:
        """What the event did: all locals, and what it wrote of shared variables and actuators."""
        shared: dict[str, Any] = {}
        actuators: dict[str, Any] = {}
        if self.shared_x.written:
            shared["x"] = self.shared_x.own
        if self.shared_class.written:
            shared["class"] = self.shared_class.own
        if self.shared_lowest.written:
            shared["lowest"] = self.shared_lowest.value
        if self.shared_done.written:
            shared["done"] = self.shared_done.value
        if self.motion_target.written:
            actuators["Motion.target"] = self.motion_target.value
        kept: dict[str, Any] = {
            "count": self.local_count,
            "level": self.local_level,
            "on": self.local_on,
            "last": self.local_last,
        }
        return Effects(kept, shared, actuators, stopped)


def init(s: State) -> None:
    s.shared_x.own = s.motion_position  # kitchen.koord:25
    if s.pid == 0:  # kitchen.koord:26
        s.shared_lowest.value = distance(s.motion_position, PARAM_HOME)  # kitchen.koord:27


def guard_advance(s: State) -> bool:
    """pre of Advance, kitchen.koord:29"""
    return s.local_on and s.motion_reached and s.local_count < PARAM_LAPS and not s.shared_done.value  # kitchen.koord:30


def effect_advance(s: State) -> None:
    """eff of Advance, kitchen.koord:29"""
    my_goal: Point = (s.shared_x[s.pid] + PARAM_HOME) / 2.0 - 0.25 * Point(0.0, 0.0, 1.0)  # kitchen.koord:32
    if distance(my_goal, s.motion_position) > PARAM_MARGIN:  # kitchen.koord:33
        s.motion_target.value = my_goal  # kitchen.koord:34
    elif s.pid % 2 == 0 and s.n_sys > 1:  # kitchen.koord:35
        s.motion_target.value = -my_goal + s.shared_x[(s.pid + 1) % s.n_sys]  # kitchen.koord:36
    else:
        my_goal = Point(abs(my_goal.x), min(my_goal.y, s.local_level), max(my_goal.z, sqrt(4.0)))  # kitchen.koord:38
        s.motion_target.value = my_goal  # kitchen.koord:39
    s.local_count = s.local_count + 1  # kitchen.koord:40
    s.shared_class.own = s.local_count // 2 if s.local_on else -(s.local_count - 1)  # kitchen.koord:41
    s.local_level = s.local_level / float(s.local_count + 1)  # kitchen.koord:42
    s.shared_x.own = s.motion_position  # kitchen.koord:43


def guard_finish(s: State) -> bool:
    """pre of Finish, kitchen.koord:45"""
    return s.local_count >= PARAM_LAPS or s.shared_done.value  # kitchen.koord:46


def effect_finish(s: State) -> None:
    """eff of Finish, kitchen.koord:45"""
    s.shared_done.value = True  # kitchen.koord:48
    s.local_on = False  # kitchen.koord:49
    s.local_last = s.motion_target.value  # kitchen.koord:50
    raise Stopped  # kitchen.koord:51


# Line of this file -> line of kitchen.koord.
LINES: dict[int, int] = {15: 2, 16: 3, 17: 4, 62: 25, 63: 26, 64: 27, 69: 30, 74: 32, 75: 33, 76: 34, 77: 35, 78: 36, 80: 38, 81: 39, 82: 40, 83: 41, 84: 42, 85: 43, 90: 46, 95: 48, 96: 49, 97: 50, 98: 51, 110: 19, 111: 20, 112: 21, 113: 22, 116: 13, 117: 14, 118: 16, 119: 17}

PROGRAM = Program(
    name="kitchen",
    source="kitchen.koord",
    program_hash="44167199b550f01f",
    interface_hash="ba4dbd8e25df122d",
    locals=(
        Variable("count", "local", int, lambda: 0),  # kitchen.koord:19
        Variable("level", "local", float, lambda: PARAM_MARGIN * 2.0),  # kitchen.koord:20
        Variable("on", "local", bool, lambda: True),  # kitchen.koord:21
        Variable("last", "local", Point, lambda: PARAM_HOME),  # kitchen.koord:22
    ),
    shared=(
        Variable("x", "allread", Point, lambda: Point(0.0, 0.0, 0.0)),  # kitchen.koord:13
        Variable("class", "allread", int, lambda: -1),  # kitchen.koord:14
        Variable("lowest", "allwrite", float, lambda: 1000.0),  # kitchen.koord:16
        Variable("done", "allwrite", bool, lambda: False),  # kitchen.koord:17
    ),
    ports=(
        Port("Motion.position", "sensor", Point),
        Port("Motion.reached", "sensor", bool),
        Port("Motion.target", "actuator", Point),
    ),
    init=init,
    events=(
        Event("Advance", 29, guard_advance, effect_advance),
        Event("Finish", 45, guard_finish, effect_finish),
    ),
    begin=State,
    end=State.effects,
    file=__file__,
    lines=LINES,
)
