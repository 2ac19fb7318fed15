"""kitchen: the Koord program kitchen.koord, compiled by koordgen 0.1.0.

The comment `# line 12` names a line of kitchen.koord, in the folder of this file.
`s` is the state that an event reads and writes; `my_x` is a variable `x` declared in the event.
The next build overwrites this file: change the Koord program instead.
"""

from __future__ import annotations

from math import atan2, exp, floor, sqrt
from typing import Annotated, Any

from msgspec import Struct
from msgspec.structs import replace

from koordgen.runtime.program.extern import Extern, Library
from koordgen.runtime.program.metered import area, clear, mark_free, merge, path_distance
from koordgen.runtime.program.program import (
    Cell, Event, Frame, Port, Program, Slots, Stopped, Transaction, Variable
)
from koordgen.runtime.values.bounds import (
    Blob, Cells, Distinct, Fixed, Many, Pairs, Parts, Rays, Text
)
from koordgen.runtime.values.containers import (
    appended, at, extended, first, has_key, index_of, inserted, keys, map_at, map_get, map_of,
    map_with, map_without, popped, power, removed, set_of, set_with, total, union, updated, without,
)
from koordgen.runtime.values.gridmap import GridMap, cell, center, is_known
from koordgen.runtime.values.points import (
    Grid, Opaque, Point, Pose, Scan, distance, no_nan, no_nan_in
)
from koordgen.runtime.values.region import Ball, Rect
from koordgen.runtime.values.text import shown
from koordgen.runtime.values.turns import looked, looked_in, made, minus, plus, turn, turns

# Python and Koord compute the same values. Operators and functions that need an explanation:
#   a + b             of ints has no overflow; more than 64 bits in a variable discard the event
#   a // b, a % b     round down, also below 0: -7 // 2 is -4, and -7 % 2 is 1
#   a / b             of ints is a float; b == 0 discards the event
#   at(xs, i)         is xs[i]; i < 0 or i >= len(xs) discards the event
#   power(a, b)       is a ** b; of two ints it is an int, and b < 0 discards the event
#   plus(a, b)        is a + b; more than 4096 bits discard the event
#   total(xs)         adds floats from left to right: how `sum` rounds depends on Python's version
#   round(x)          rounds half to even: round(2.5) is 2
#   no_nan(x)         is x; NaN discards the event, where a comparison alone would be false
#   str(x), shown(p)  write numbers as Python does, 2.5 or 1e+20, and a Point as (x, y, z)
#   appended, replace make a new value: values never change, so an assignment need not copy
#   set_of, map_of    make sorted tuples: all robots iterate over a set or map in the same order
#   turns(xs)         is xs, and counts turns: an event has at most a million turns and calls
#   made(xs)          is xs, and counts a turn for each 100 elements; so does looked(xs)
#   f(a) + g(b)       calls f first: operands are evaluated from left to right, as in Koord

Ticket = Annotated[Opaque, "Ticket"]


class Cup(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """def Cup, kitchen.koord:7"""

    at: Point = Point(1.0, 2.0, 3.0)
    name: str = "it's a \"cup\""
    size: int = 0


class Tray(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """def Tray, kitchen.koord:2"""

    first: Cup = Cup(Point(1.0, 2.0, 3.0), "it's a \"cup\"", 0)
    class_: tuple[Cup, ...] = ()
    None_: tuple[int, str] = (0, "")


# Size bounds of records.
BOUND_CUP = Parts(
    items=(Fixed(bytes=28), Text(capacity=16), Fixed(bytes=9)), fields=("at", "name", "size")
)
BOUND_TRAY = Parts(
    items=(
        BOUND_CUP,
        Many(capacity=3, element=BOUND_CUP),
        Parts(items=(Fixed(bytes=9), Text(capacity=256))),
    ),
    fields=("first", "class_", "None_"),
)

PARAM_MARGIN: float = 0.5  # line 36
PARAM_LAPS: int = 3  # line 37
PARAM_HOME: Point = Point(1.0, -2.0, 0.5)  # line 38
PARAM_CUPS: tuple[Cup, ...] = (  # line 39
    Cup(Point(0.0, 1.0, 0.0), "one", 1), Cup(Point(1.0, 2.0, 3.0), "it's a \"cup\"", 2)
)
PARAM_LABELS: tuple[tuple[int, str], ...] = map_of(((1, "a"), (2, "b")))  # line 40

LIBRARY = Library("kitchen_functions")
EXTERN_STAMP = Extern(
    library=LIBRARY,
    name="stamp",
    parameters=(
        Blob(capacity=256, name="Ticket"),
        BOUND_CUP,
        Many(capacity=128, element=Many(capacity=64, element=Fixed(bytes=28))),
    ),
    result=Blob(capacity=256, name="Ticket"),
    type=Ticket,
    wanted="a Ticket",
)
EXTERN_WEIGH = Extern(
    library=LIBRARY,
    name="weigh",
    parameters=(
        Pairs(capacity=64, key=Text(capacity=256), value=Fixed(bytes=9)),
        Distinct(capacity=64, element=Fixed(bytes=9)),
    ),
    result=Fixed(bytes=9),
    type=float,
    wanted="a float",
)


class State(Transaction):
    """State of one robot during one event of kitchen, with the writes of the event so far."""

    def __init__(self, frame: Frame) -> None:
        super().__init__(frame)
        self.motion_position: Point = frame.sensors["Motion.position"]
        self.motion_reached: bool = frame.sensors["Motion.reached"]
        self.motion_pscan: tuple[tuple[Point, Scan], ...] = frame.sensors["Motion.pscan"]
        self.motion_target: Cell[Point] = self.actuator("Motion.target")
        self.motion_path: Cell[tuple[Point, ...]] = self.actuator("Motion.path")
        self.shared_x: Slots[Point] = self.slots("x")
        self.shared_class: Slots[int] = self.slots("class")
        self.shared_paths: Slots[tuple[Point, ...]] = self.slots("paths")
        self.shared_lowest: Cell[float] = self.shared("lowest")
        self.shared_done: Cell[bool] = self.shared("done")
        self.shared_names: Cell[tuple[tuple[int, str], ...]] = self.shared("names")
        self.shared_waiting: Cell[tuple[Cup, ...]] = self.shared("waiting")
        self.local_count: Cell[int] = self.local("count")
        self.local_level: Cell[float] = self.local("level")
        self.local_on: Cell[bool] = self.local("on")
        self.local_spot: Cell[Point] = self.local("spot")
        self.local_seen: Cell[tuple[tuple[int, bool], ...]] = self.local("seen")
        self.local_known: Cell[GridMap] = self.local("known")
        self.local_scan: Cell[Scan] = self.local("scan")
        self.local_pose: Cell[Pose] = self.local("pose")
        self.local_tray: Cell[Tray] = self.local("tray")
        self.local_ticket: Cell[Ticket] = self.local("ticket")
        self.local_text: Cell[str] = self.local("text")
        self.local_levels: Cell[tuple[float, ...]] = self.local("levels")

    def motion_planner(self, *args: Any) -> tuple[Point, ...]:
        """A call of "Motion.planner"."""
        found: tuple[Point, ...] = self.call("Motion.planner", args)
        return found


def extern_stamp(my_t: Ticket, my_cup: Cup, my_where: tuple[tuple[Point, ...], ...]) -> Ticket:
    """extern fun stamp, kitchen.koord:13"""
    my_result: Ticket = EXTERN_STAMP(my_t, my_cup, my_where)
    return my_result


def extern_weigh(my_goods: tuple[tuple[str, int], ...], my_s: tuple[int, ...]) -> float:
    """extern fun weigh, kitchen.koord:14"""
    EXTERN_WEIGH.require(len(my_goods) > 0, 15)
    my_result: float = EXTERN_WEIGH(my_goods, my_s)
    EXTERN_WEIGH.ensure(no_nan(my_result) >= 0.0, 16, my_result)
    return my_result


def fun_longest(my_words: tuple[str, ...]) -> str:
    """fun longest, kitchen.koord:18"""
    turn()  # line 18
    my_best: str = ""  # line 19
    for my_w in turns(my_words):  # line 20
        if len(my_w) > len(my_best):  # line 21
            my_best = my_w  # line 22
    return my_best  # line 23


def fun_reduce(my_n: int, my_s: int) -> int:
    """fun reduce, kitchen.koord:25"""
    turn()  # line 25
    while turn():  # line 26
        if my_n % 2 != 0:  # line 27
            return minus(power(my_n, 2), power(2, my_n))  # line 28
        my_n //= 2  # line 29
        if my_n < my_s:  # line 30
            break  # line 31
    return -my_n  # line 32


def fun_heavy(my_c: Cup) -> bool:
    """fun heavy, kitchen.koord:34"""
    turn()  # line 34
    return (  # line 34
        my_c.size > 3
        and no_nan(extern_weigh(map_of(((my_c.name, my_c.size),)), set_of((1, 2)))) > 2.0
    )


def init(s: State) -> None:
    s.shared_x.own = s.motion_position  # line 80
    if s.pid == 0:  # line 81
        s.shared_lowest.value = distance(s.motion_position, PARAM_HOME)  # line 82


def guard_advance(s: State) -> bool:
    """pre of Advance, kitchen.koord:84"""
    return (  # line 85
        s.local_on.value
        and s.motion_reached
        and s.local_count.value < PARAM_LAPS
        and not s.shared_done.value
    )


def effect_advance(s: State) -> None:
    """eff of Advance, kitchen.koord:84"""
    my_goal: Point = (s.shared_x[s.pid] + PARAM_HOME) / 2.0 - 0.25 * Point(0.0, 0.0, 1.0)  # line 87
    if no_nan(distance(my_goal, s.motion_position)) > PARAM_MARGIN:  # line 88
        s.motion_target.value = my_goal  # line 89
    elif s.pid % 2 == 0 and s.n_sys > 1:  # line 90
        s.motion_target.value = -my_goal + s.shared_x[(s.pid + 1) % s.n_sys]  # line 91
    else:
        my_goal = Point(  # line 93
            abs(my_goal.x),
            min(no_nan(my_goal.y), s.local_level.value),
            max(no_nan(my_goal.z), sqrt(4.0)),
        )
        s.motion_target.value = my_goal  # line 94
    s.local_count.value += 1  # line 95
    s.shared_class.own = (  # line 96
        s.local_count.value // 2 if s.local_on.value else -(s.local_count.value - 1)
    )
    s.local_level.value /= float(s.local_count.value + 1)  # line 97
    s.shared_x.own = s.motion_position  # line 98


def guard_collect(s: State) -> bool:
    """pre of Collect, kitchen.koord:100"""
    return (  # line 101
        s.motion_position in Rect(PARAM_HOME, Point(0.0, 0.0, 0.0))
        or (
            s.local_spot.value not in Ball(PARAM_HOME, 1.0)
            and (0 < s.local_count.value and s.local_count.value < 5)
        )
    )


def effect_collect(s: State) -> None:
    """eff of Collect, kitchen.koord:100"""
    for my_c in turns(PARAM_CUPS):  # line 103
        s.shared_waiting.value = appended(s.shared_waiting.value, my_c)  # line 104
        if my_c.size == 2 or "e" in looked(my_c.name):  # line 105
            continue  # line 106
    for my_i in turns(range(1, PARAM_LAPS, 2)):  # line 107
        s.local_seen.value = set_with(s.local_seen.value, (my_i, s.local_on.value))  # line 108
    for my_i_2 in turns(range(s.n_sys)):  # line 109
        if (  # line 110
            (my_i_2, False) in looked_in(s.local_seen.value) and s.shared_x[my_i_2] != PARAM_HOME
        ):
            s.local_seen.value = union(  # line 111
                looked_in(s.local_seen.value), set_of(((my_i_2, True),))
            )
    for my_n, my_b in turns(s.local_seen.value):  # line 112
        s.local_text.value = made(made(s.local_text.value + str(my_n)) + str(my_b))  # line 113
    for my_p, my_s in turns(s.motion_pscan):  # line 114
        s.local_scan.value = my_s  # line 115
        s.local_level.value += total(looked(my_s.ranges)) + atan2(my_p.y, my_p.x)  # line 116
    my_c_2: Cup = first(s.shared_waiting.value)  # line 117
    s.shared_waiting.value = without(s.shared_waiting.value, 0)  # line 117
    s.local_tray.value = replace(  # line 118
        s.local_tray.value, class_=appended(s.local_tray.value.class_, my_c_2)
    )
    s.local_tray.value = replace(  # line 119
        s.local_tray.value,
        class_=updated(
            s.local_tray.value.class_,
            0,
            replace(
                at(s.local_tray.value.class_, 0),
                size=plus(
                    at(s.local_tray.value.class_, 0).size,
                    plus(
                        round(s.local_level.value),
                        floor(at(s.local_levels.value, s.local_count.value)),
                    ),
                ),
            ),
        ),
    )
    s.local_tray.value = replace(  # line 120
        s.local_tray.value,
        None_=(
            s.local_count.value,
            fun_longest((s.local_text.value, made(at(s.local_tray.value.class_, 0).name[1:3]))),
        ),
    )
    s.local_text.value = s.local_tray.value.None_[1]  # line 121
    s.local_levels.value = inserted(s.local_levels.value, 0, exp(s.local_level.value))  # line 122
    s.local_levels.value = removed(no_nan_in(looked(s.local_levels.value)), 2.5)  # line 123
    s.local_levels.value = extended(  # line 124
        s.local_levels.value,
        made(
            made(made(tuple(sorted(no_nan_in(looked(s.local_levels.value)))))[:2])
            + made(tuple(reversed(s.local_levels.value)))
        ),
    )
    s.local_level.value = at(s.local_levels.value, len(s.local_levels.value) - 1)  # line 125
    s.local_levels.value = popped(s.local_levels.value)  # line 125
    my_where: int = (  # line 126
        index_of(no_nan_in(looked(s.local_levels.value)), no_nan(s.local_level.value))
        + no_nan_in(looked(s.local_levels.value)).count(no_nan(s.local_level.value))
        + fun_reduce(s.local_count.value, len(s.local_levels.value))
    )
    s.local_ticket.value = extern_stamp(  # line 127
        s.local_ticket.value, my_c_2, s.shared_paths.all
    )
    if fun_heavy(my_c_2):  # line 128
        s.emit(  # line 129
            "Log.stdout", "heavy ", my_c_2.name, str(my_where), " at ", shown(my_c_2.at)
        )


def guard_plan(s: State) -> bool:
    """pre of Plan, kitchen.koord:131"""
    return len(s.shared_waiting.value) > 0  # line 132


def effect_plan(s: State) -> None:
    """eff of Plan, kitchen.koord:131"""
    my_c: Cup = first(s.shared_waiting.value)  # line 134
    my_way: tuple[Point, ...] = s.motion_planner(my_c.at, (Grid(1, 2, 0.5),))  # line 135
    if (  # line 136
        len(my_way) > 0
        and clear(my_way, s.shared_paths.all, PARAM_MARGIN)
        and path_distance(my_way, (PARAM_HOME,)) > 1.0
    ):
        s.motion_path.value = my_way  # line 137
        s.shared_paths.own = made(my_way[:3])  # line 138
    s.local_known.value = merge(  # line 139
        s.local_known.value, mark_free(s.local_known.value, cell(my_c.at, 0.5))
    )
    if (  # line 140
        is_known(s.local_known.value, Grid(1, 1, 0.5))
        and map_get(s.shared_names.value, s.pid, "") != my_c.name
    ):
        s.shared_names.value = map_with(s.shared_names.value, s.pid, my_c.name)  # line 141
        s.local_pose.value = Pose(center(Grid(1, 1, 0.5)), s.local_pose.value.yaw)  # line 142
    for my_k in turns(keys(s.shared_names.value)):  # line 143
        if (  # line 144
            map_at(s.shared_names.value, my_k) == map_at(PARAM_LABELS, 1)
            and not has_key(PARAM_LABELS, my_k)
            and my_k not in looked(keys(s.shared_names.value))
        ):
            s.shared_names.value = map_without(s.shared_names.value, my_k)  # line 145
    for my_k_2, my_v in turns(s.shared_names.value):  # line 146
        s.local_text.value = my_v if my_k_2 > 1 else at(s.local_text.value, 0)  # line 147
    s.shared_waiting.value = without(s.shared_waiting.value, 0)  # line 148


def guard_finish(s: State) -> bool:
    """pre of Finish, kitchen.koord:150"""
    return s.local_count.value >= PARAM_LAPS or s.shared_done.value  # line 151


def effect_finish(s: State) -> None:
    """eff of Finish, kitchen.koord:150"""
    s.shared_done.value = True  # line 153
    s.local_on.value = False  # line 154
    s.local_spot.value = s.motion_target.value  # line 155
    raise Stopped  # line 156


# Line of this file: line of kitchen.koord.
LINES: dict[int, int] = {
    85: 36, 86: 37, 87: 38, 88: 39, 89: 39, 90: 39, 91: 40, 171: 18, 172: 19, 173: 20, 174: 21,
    175: 22, 176: 23, 181: 25, 182: 26, 183: 27, 184: 28, 185: 29, 186: 30, 187: 31, 188: 32,
    193: 34, 194: 34, 195: 34, 196: 34, 197: 34, 201: 80, 202: 81, 203: 82, 208: 85, 209: 85,
    210: 85, 211: 85, 212: 85, 213: 85, 218: 87, 219: 88, 220: 89, 221: 90, 222: 91, 224: 93,
    225: 93, 226: 93, 227: 93, 228: 93, 229: 94, 230: 95, 231: 96, 232: 96, 233: 96, 234: 97,
    235: 98, 240: 101, 241: 101, 242: 101, 243: 101, 244: 101, 245: 101, 246: 101, 251: 103,
    252: 104, 253: 105, 254: 106, 255: 107, 256: 108, 257: 109, 258: 110, 259: 110, 260: 110,
    261: 111, 262: 111, 263: 111, 264: 112, 265: 113, 266: 114, 267: 115, 268: 116, 269: 117,
    270: 117, 271: 118, 272: 118, 273: 118, 274: 119, 275: 119, 276: 119, 277: 119, 278: 119,
    279: 119, 280: 119, 281: 119, 282: 119, 283: 119, 284: 119, 285: 119, 286: 119, 287: 119,
    288: 119, 289: 119, 290: 119, 291: 120, 292: 120, 293: 120, 294: 120, 295: 120, 296: 120,
    297: 120, 298: 121, 299: 122, 300: 123, 301: 124, 302: 124, 303: 124, 304: 124, 305: 124,
    306: 124, 307: 124, 308: 125, 309: 125, 310: 126, 311: 126, 312: 126, 313: 126, 314: 126,
    315: 127, 316: 127, 317: 127, 318: 128, 319: 129, 320: 129, 321: 129, 326: 132, 331: 134,
    332: 135, 333: 136, 334: 136, 335: 136, 336: 136, 337: 136, 338: 137, 339: 138, 340: 139,
    341: 139, 342: 139, 343: 140, 344: 140, 345: 140, 346: 140, 347: 141, 348: 142, 349: 143,
    350: 144, 351: 144, 352: 144, 353: 144, 354: 144, 355: 145, 356: 146, 357: 147, 358: 148,
    363: 151, 368: 153, 369: 154, 370: 155, 371: 156,
}

PROGRAM = Program(
    name="kitchen",
    source="kitchen.koord",
    program_hash="e6936348b9edc9c9",
    interface_hash="fdb0b0d0da7d441f",
    locals=(
        Variable(  # line 66
            name="count", kind="local", type=int, bound=Fixed(bytes=9), initial=lambda: 0
        ),
        Variable(  # line 67
            name="level",
            kind="local",
            type=float,
            bound=Fixed(bytes=9),
            initial=lambda: PARAM_MARGIN * 2.0,
        ),
        Variable(  # line 68
            name="on", kind="local", type=bool, bound=Fixed(bytes=1), initial=lambda: True
        ),
        Variable(  # line 69
            name="spot", kind="local", type=Point, bound=Fixed(bytes=28), initial=lambda: PARAM_HOME
        ),
        Variable(  # line 70
            name="seen",
            kind="local",
            type=tuple[tuple[int, bool], ...],
            bound=Distinct(capacity=4096, element=Parts(items=(Fixed(bytes=9), Fixed(bytes=1)))),
            initial=lambda: (),
        ),
        Variable(  # line 71
            name="known",
            kind="local",
            type=GridMap,
            bound=Cells(capacity=100),
            initial=lambda: area(Point(0.0, 0.0, 0.0), Point(5.0, 5.0, 0.0), 0.5),
        ),
        Variable(  # line 72
            name="scan", kind="local", type=Scan, bound=Rays(capacity=4096), initial=lambda: Scan()
        ),
        Variable(  # line 73
            name="pose",
            kind="local",
            type=Pose,
            bound=Fixed(bytes=38),
            initial=lambda: Pose(PARAM_HOME, 3.141592653589793 / 2.0),
        ),
        Variable(  # line 74
            name="tray",
            kind="local",
            type=Tray,
            bound=BOUND_TRAY,
            initial=lambda: Tray(Cup(Point(1.0, 2.0, 3.0), "it's a \"cup\"", 0), (), (0, "")),
        ),
        Variable(  # line 75
            name="ticket",
            kind="local",
            type=Ticket,
            bound=Blob(capacity=256, name="Ticket"),
            initial=lambda: Opaque(),
        ),
        Variable(  # line 76
            name="text", kind="local", type=str, bound=Text(capacity=4096), initial=lambda: ""
        ),
        Variable(  # line 77
            name="levels",
            kind="local",
            type=tuple[float, ...],
            bound=Many(capacity=4096, element=Fixed(bytes=9)),
            initial=lambda: (1.0, 2.5),
        ),
    ),
    shared=(
        Variable(  # line 57
            name="x",
            kind="allread",
            type=Point,
            bound=Fixed(bytes=28),
            initial=lambda: Point(0.0, 0.0, 0.0),
        ),
        Variable(  # line 58
            name="class", kind="allread", type=int, bound=Fixed(bytes=9), initial=lambda: -1
        ),
        Variable(  # line 59
            name="paths",
            kind="allread",
            type=tuple[Point, ...],
            bound=Many(capacity=3, element=Fixed(bytes=28)),
            initial=lambda: (),
        ),
        Variable(  # line 61
            name="lowest", kind="allwrite", type=float, bound=Fixed(bytes=9), initial=lambda: 1000.0
        ),
        Variable(  # line 62
            name="done", kind="allwrite", type=bool, bound=Fixed(bytes=1), initial=lambda: False
        ),
        Variable(  # line 63
            name="names",
            kind="allwrite",
            type=tuple[tuple[int, str], ...],
            bound=Pairs(capacity=3, key=Fixed(bytes=9), value=Text(capacity=8)),
            initial=lambda: (),
        ),
        Variable(  # line 64
            name="waiting",
            kind="allwrite",
            type=tuple[Cup, ...],
            bound=Many(capacity=2, element=BOUND_CUP),
            initial=lambda: (),
        ),
    ),
    ports=(
        Port(name="Motion.position", direction="sensor", type=Point, is_position=True),
        Port(name="Motion.reached", direction="sensor", type=bool),
        Port(name="Motion.pscan", direction="sensor", type=tuple[tuple[Point, Scan], ...]),
        Port(
            name="Motion.target",
            direction="actuator",
            type=Point,
            bound=Fixed(bytes=28),
            unset=lambda: Point(),
            held="Motion.position",
            clears=("Motion.reached",),
        ),
        Port(
            name="Motion.path",
            direction="actuator",
            type=tuple[Point, ...],
            bound=Many(capacity=4096, element=Fixed(bytes=28)),
            unset=lambda: (),
            clears=("Motion.reached",),
        ),
        Port(name="Motion.planner", direction="callable", type=tuple[Point, ...]),
        Port(name="Log.stdout", direction="stream", type=str),
    ),
    init=init,
    events=(
        Event(name="Advance", line=84, guard=guard_advance, effect=effect_advance),
        Event(name="Collect", line=100, guard=guard_collect, effect=effect_collect),
        Event(name="Plan", line=131, guard=guard_plan, effect=effect_plan, lock=0),
        Event(name="Finish", line=150, guard=guard_finish, effect=effect_finish),
    ),
    begin=State,
    file=__file__,
    lines=LINES,
    locks=(("paths", "names", "waiting"),),
    library=LIBRARY,
)
