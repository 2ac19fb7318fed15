"""kitchen: the Koord program kitchen.koord, compiled by koordgen 0.1.0.

Every statement names its line in kitchen.koord, which stands beside this file. The next build writes this
file anew: change the Koord program, not this.
"""

from __future__ import annotations

from math import sqrt

from koordgen.runtime.bounds import Fixed
from koordgen.runtime.program import Cell, Event, Frame, Port, Program, Slots, Stopped, Transaction, Variable
from koordgen.runtime.values import Point, distance

PARAM_MARGIN: float = 0.5  # kitchen.koord:2
PARAM_LAPS: int = 3  # kitchen.koord:3
PARAM_HOME: Point = Point(1.0, -2.0, 0.5)  # kitchen.koord:4


class State(Transaction):
    """What one event of kitchen sees on one robot, and what it has written so far."""

    def __init__(self, frame: Frame) -> None:
        super().__init__(frame)
        self.motion_position: Point = frame.sensors["Motion.position"]
        self.motion_reached: bool = frame.sensors["Motion.reached"]
        self.motion_target: Cell[Point] = self.actuator("Motion.target")
        self.shared_x: Slots[Point] = self.slots("x")
        self.shared_class: Slots[int] = self.slots("class")
        self.shared_lowest: Cell[float] = self.shared("lowest")
        self.shared_done: Cell[bool] = self.shared("done")
        self.local_count: Cell[int] = self.local("count")
        self.local_level: Cell[float] = self.local("level")
        self.local_on: Cell[bool] = self.local("on")
        self.local_spot: Cell[Point] = self.local("spot")


def init(s: State) -> None:
    s.shared_x.own = s.motion_position  # kitchen.koord:25
    if s.pid == 0:  # kitchen.koord:26
        s.shared_lowest.value = distance(s.motion_position, PARAM_HOME)  # kitchen.koord:27


def guard_advance(s: State) -> bool:
    """pre of Advance, kitchen.koord:29"""
    return s.local_on.value and s.motion_reached and s.local_count.value < PARAM_LAPS and not s.shared_done.value  # kitchen.koord:30


def effect_advance(s: State) -> None:
    """eff of Advance, kitchen.koord:29"""
    my_goal: Point = (s.shared_x[s.pid] + PARAM_HOME) / 2.0 - 0.25 * Point(0.0, 0.0, 1.0)  # kitchen.koord:32
    if distance(my_goal, s.motion_position) > PARAM_MARGIN:  # kitchen.koord:33
        s.motion_target.value = my_goal  # kitchen.koord:34
    elif s.pid % 2 == 0 and s.n_sys > 1:  # kitchen.koord:35
        s.motion_target.value = -my_goal + s.shared_x[(s.pid + 1) % s.n_sys]  # kitchen.koord:36
    else:
        my_goal = Point(abs(my_goal.x), min(my_goal.y, s.local_level.value), max(my_goal.z, sqrt(4.0)))  # kitchen.koord:38
        s.motion_target.value = my_goal  # kitchen.koord:39
    s.local_count.value = s.local_count.value + 1  # kitchen.koord:40
    s.shared_class.own = s.local_count.value // 2 if s.local_on.value else -(s.local_count.value - 1)  # kitchen.koord:41
    s.local_level.value = s.local_level.value / float(s.local_count.value + 1)  # kitchen.koord:42
    s.shared_x.own = s.motion_position  # kitchen.koord:43


def guard_finish(s: State) -> bool:
    """pre of Finish, kitchen.koord:45"""
    return s.local_count.value >= PARAM_LAPS or s.shared_done.value  # kitchen.koord:46


def effect_finish(s: State) -> None:
    """eff of Finish, kitchen.koord:45"""
    s.shared_done.value = True  # kitchen.koord:48
    s.local_on.value = False  # kitchen.koord:49
    s.local_spot.value = s.motion_target.value  # kitchen.koord:50
    raise Stopped  # kitchen.koord:51


# Line of this file -> line of kitchen.koord.
LINES: dict[int, int] = {15: 2, 16: 3, 17: 4, 39: 25, 40: 26, 41: 27, 46: 30, 51: 32, 52: 33, 53: 34, 54: 35, 55: 36, 57: 38, 58: 39, 59: 40, 60: 41, 61: 42, 62: 43, 67: 46, 72: 48, 73: 49, 74: 50, 75: 51, 87: 19, 88: 20, 89: 21, 90: 22, 93: 13, 94: 14, 95: 16, 96: 17}

PROGRAM = Program(
    name="kitchen",
    source="kitchen.koord",
    program_hash="0f5bb0004705f921",
    interface_hash="dd5868b9d72687ba",
    locals=(
        Variable("count", "local", int, Fixed(9), lambda: 0),  # kitchen.koord:19
        Variable("level", "local", float, Fixed(9), lambda: PARAM_MARGIN * 2.0),  # kitchen.koord:20
        Variable("on", "local", bool, Fixed(1), lambda: True),  # kitchen.koord:21
        Variable("spot", "local", Point, Fixed(28), lambda: PARAM_HOME),  # kitchen.koord:22
    ),
    shared=(
        Variable("x", "allread", Point, Fixed(28), lambda: Point(0.0, 0.0, 0.0)),  # kitchen.koord:13
        Variable("class", "allread", int, Fixed(9), lambda: -1),  # kitchen.koord:14
        Variable("lowest", "allwrite", float, Fixed(9), lambda: 1000.0),  # kitchen.koord:16
        Variable("done", "allwrite", bool, Fixed(1), lambda: False),  # kitchen.koord:17
    ),
    ports=(
        Port("Motion.position", "sensor", Point),
        Port("Motion.reached", "sensor", bool),
        Port("Motion.target", "actuator", Point, Fixed(28), lambda: Point()),
    ),
    init=init,
    events=(
        Event("Advance", 29, guard_advance, effect_advance),
        Event("Finish", 45, guard_finish, effect_finish),
    ),
    begin=State,
    file=__file__,
    lines=LINES,
    locks=(),
    library=None,
)
