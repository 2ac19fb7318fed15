"""kitchen: the Koord program kitchen.koord, compiled by koordgen 0.1.0.

Every statement names its line in kitchen.koord, which stands beside this file. The next build writes this
file anew: change the Koord program, not this.
"""

from __future__ import annotations

from math import atan2, exp, floor, sqrt
from typing import Annotated, Any

from msgspec import Struct
from msgspec.structs import replace

from koordgen.runtime.values.bounds import Blob, Cells, Distinct, Fixed, Many, Pairs, Parts, Rays, Text
from koordgen.runtime.values.containers import (
    appended,
    at,
    extended,
    first,
    has_key,
    index_of,
    inserted,
    keys,
    map_at,
    map_get,
    map_of,
    map_with,
    map_without,
    popped,
    power,
    removed,
    set_of,
    set_with,
    total,
    union,
    updated,
    without,
)
from koordgen.runtime.program.extern import Extern, Library
from koordgen.runtime.values.gridmap import GridMap, cell, center, is_known
from koordgen.runtime.program.metered import area, clear, mark_free, merge, path_distance
from koordgen.runtime.program.program import Cell, Event, Frame, Port, Program, Slots, Stopped, Transaction, Variable
from koordgen.runtime.values.region import Ball, Rect
from koordgen.runtime.values.text import shown
from koordgen.runtime.values.turns import looked, looked_in, made, minus, plus, turn, turns
from koordgen.runtime.values.points import Grid, Opaque, Point, Pose, Scan, distance, no_nan, no_nan_in

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


PARAM_MARGIN: float = 0.5  # kitchen.koord:36
PARAM_LAPS: int = 3  # kitchen.koord:37
PARAM_HOME: Point = Point(1.0, -2.0, 0.5)  # kitchen.koord:38
PARAM_CUPS: tuple[Cup, ...] = (Cup(Point(0.0, 1.0, 0.0), "one", 1), Cup(Point(1.0, 2.0, 3.0), "it's a \"cup\"", 2))  # kitchen.koord:39
PARAM_LABELS: tuple[tuple[int, str], ...] = map_of(((1, "a"), (2, "b")))  # kitchen.koord:40

LIBRARY = Library("kitchen_functions")
EXTERN_STAMP = Extern(LIBRARY, "stamp", (Blob(256, "Ticket"), Parts((Fixed(28), Text(16), Fixed(9)), ("at", "name", "size")), Many(128, Many(64, Fixed(28)))), Blob(256, "Ticket"), Ticket, "a Ticket")
EXTERN_WEIGH = Extern(LIBRARY, "weigh", (Pairs(64, Text(256), Fixed(9)), Distinct(64, Fixed(9))), Fixed(9), float, "a float")


class State(Transaction):
    """What one event of kitchen sees on one robot, and what it has written so far."""

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
    turn()  # kitchen.koord:18
    my_best: str = ""  # kitchen.koord:19
    for my_w in turns(my_words):  # kitchen.koord:20
        if len(my_w) > len(my_best):  # kitchen.koord:21
            my_best = my_w  # kitchen.koord:22
    return my_best  # kitchen.koord:23


def fun_reduce(my_n: int, my_s: int) -> int:
    """fun reduce, kitchen.koord:25"""
    turn()  # kitchen.koord:25
    while turn():  # kitchen.koord:26
        if my_n % 2 != 0:  # kitchen.koord:27
            return minus(power(my_n, 2), power(2, my_n))  # kitchen.koord:28
        my_n = my_n // 2  # kitchen.koord:29
        if my_n < my_s:  # kitchen.koord:30
            break  # kitchen.koord:31
    return -my_n  # kitchen.koord:32


def fun_heavy(my_c: Cup) -> bool:
    """fun heavy, kitchen.koord:34"""
    turn()  # kitchen.koord:34
    return my_c.size > 3 and no_nan(extern_weigh(map_of(((my_c.name, my_c.size),)), set_of((1, 2)))) > 2.0  # kitchen.koord:34


def init(s: State) -> None:
    s.shared_x.own = s.motion_position  # kitchen.koord:80
    if s.pid == 0:  # kitchen.koord:81
        s.shared_lowest.value = distance(s.motion_position, PARAM_HOME)  # kitchen.koord:82


def guard_advance(s: State) -> bool:
    """pre of Advance, kitchen.koord:84"""
    return s.local_on.value and s.motion_reached and s.local_count.value < PARAM_LAPS and not s.shared_done.value  # kitchen.koord:85


def effect_advance(s: State) -> None:
    """eff of Advance, kitchen.koord:84"""
    my_goal: Point = (s.shared_x[s.pid] + PARAM_HOME) / 2.0 - 0.25 * Point(0.0, 0.0, 1.0)  # kitchen.koord:87
    if no_nan(distance(my_goal, s.motion_position)) > PARAM_MARGIN:  # kitchen.koord:88
        s.motion_target.value = my_goal  # kitchen.koord:89
    elif s.pid % 2 == 0 and s.n_sys > 1:  # kitchen.koord:90
        s.motion_target.value = -my_goal + s.shared_x[(s.pid + 1) % s.n_sys]  # kitchen.koord:91
    else:
        my_goal = Point(abs(my_goal.x), min(no_nan(my_goal.y), s.local_level.value), max(no_nan(my_goal.z), sqrt(4.0)))  # kitchen.koord:93
        s.motion_target.value = my_goal  # kitchen.koord:94
    s.local_count.value = s.local_count.value + 1  # kitchen.koord:95
    s.shared_class.own = s.local_count.value // 2 if s.local_on.value else -(s.local_count.value - 1)  # kitchen.koord:96
    s.local_level.value = s.local_level.value / float(s.local_count.value + 1)  # kitchen.koord:97
    s.shared_x.own = s.motion_position  # kitchen.koord:98


def guard_collect(s: State) -> bool:
    """pre of Collect, kitchen.koord:100"""
    return s.motion_position in Rect(PARAM_HOME, Point(0.0, 0.0, 0.0)) or s.local_spot.value not in Ball(PARAM_HOME, 1.0) and (0 < s.local_count.value and s.local_count.value < 5)  # kitchen.koord:101


def effect_collect(s: State) -> None:
    """eff of Collect, kitchen.koord:100"""
    for my_c in turns(PARAM_CUPS):  # kitchen.koord:103
        s.shared_waiting.value = appended(s.shared_waiting.value, my_c)  # kitchen.koord:104
        if my_c.size == 2 or "e" in looked(my_c.name):  # kitchen.koord:105
            continue  # kitchen.koord:106
    for my_i in turns(range(1, PARAM_LAPS, 2)):  # kitchen.koord:107
        s.local_seen.value = set_with(s.local_seen.value, (my_i, s.local_on.value))  # kitchen.koord:108
    for my_i_2 in turns(range(s.n_sys)):  # kitchen.koord:109
        if (my_i_2, False) in looked_in(s.local_seen.value) and s.shared_x[my_i_2] != PARAM_HOME:  # kitchen.koord:110
            s.local_seen.value = union(looked_in(s.local_seen.value), set_of(((my_i_2, True),)))  # kitchen.koord:111
    for my_n, my_b in turns(s.local_seen.value):  # kitchen.koord:112
        s.local_text.value = made(made(s.local_text.value + str(my_n)) + str(my_b))  # kitchen.koord:113
    for my_p, my_s in turns(s.motion_pscan):  # kitchen.koord:114
        s.local_scan.value = my_s  # kitchen.koord:115
        s.local_level.value = s.local_level.value + (total(looked(my_s.ranges)) + atan2(my_p.y, my_p.x))  # kitchen.koord:116
    my_c_2: Cup = first(s.shared_waiting.value)  # kitchen.koord:117
    s.shared_waiting.value = without(s.shared_waiting.value, 0)  # kitchen.koord:117
    s.local_tray.value = replace(s.local_tray.value, class_=appended(s.local_tray.value.class_, my_c_2))  # kitchen.koord:118
    s.local_tray.value = replace(s.local_tray.value, class_=updated(s.local_tray.value.class_, 0, replace(at(s.local_tray.value.class_, 0), size=plus(at(s.local_tray.value.class_, 0).size, plus(round(s.local_level.value), floor(at(s.local_levels.value, s.local_count.value)))))))  # kitchen.koord:119
    s.local_tray.value = replace(s.local_tray.value, None_=(s.local_count.value, fun_longest((s.local_text.value, made(at(s.local_tray.value.class_, 0).name[1:3])))))  # kitchen.koord:120
    s.local_text.value = s.local_tray.value.None_[1]  # kitchen.koord:121
    s.local_levels.value = inserted(s.local_levels.value, 0, exp(s.local_level.value))  # kitchen.koord:122
    s.local_levels.value = removed(no_nan_in(looked(s.local_levels.value)), 2.5)  # kitchen.koord:123
    s.local_levels.value = extended(s.local_levels.value, made(made(made(tuple(sorted(no_nan_in(looked(s.local_levels.value)))))[:2]) + made(tuple(reversed(s.local_levels.value)))))  # kitchen.koord:124
    s.local_level.value = at(s.local_levels.value, len(s.local_levels.value) - 1)  # kitchen.koord:125
    s.local_levels.value = popped(s.local_levels.value)  # kitchen.koord:125
    my_where: int = index_of(no_nan_in(looked(s.local_levels.value)), no_nan(s.local_level.value)) + no_nan_in(looked(s.local_levels.value)).count(no_nan(s.local_level.value)) + fun_reduce(s.local_count.value, len(s.local_levels.value))  # kitchen.koord:126
    s.local_ticket.value = extern_stamp(s.local_ticket.value, my_c_2, s.shared_paths.all)  # kitchen.koord:127
    if fun_heavy(my_c_2):  # kitchen.koord:128
        s.emit("Log.stdout", "heavy ", my_c_2.name, str(my_where), " at ", shown(my_c_2.at))  # kitchen.koord:129


def guard_plan(s: State) -> bool:
    """pre of Plan, kitchen.koord:131"""
    return len(s.shared_waiting.value) > 0  # kitchen.koord:132


def effect_plan(s: State) -> None:
    """eff of Plan, kitchen.koord:131"""
    my_c: Cup = first(s.shared_waiting.value)  # kitchen.koord:134
    my_way: tuple[Point, ...] = s.motion_planner(my_c.at, (Grid(1, 2, 0.5),))  # kitchen.koord:135
    if len(my_way) > 0 and clear(my_way, s.shared_paths.all, PARAM_MARGIN) and path_distance(my_way, (PARAM_HOME,)) > 1.0:  # kitchen.koord:136
        s.motion_path.value = my_way  # kitchen.koord:137
        s.shared_paths.own = made(my_way[:3])  # kitchen.koord:138
    s.local_known.value = merge(s.local_known.value, mark_free(s.local_known.value, cell(my_c.at, 0.5)))  # kitchen.koord:139
    if is_known(s.local_known.value, Grid(1, 1, 0.5)) and map_get(s.shared_names.value, s.pid, "") != my_c.name:  # kitchen.koord:140
        s.shared_names.value = map_with(s.shared_names.value, s.pid, my_c.name)  # kitchen.koord:141
        s.local_pose.value = Pose(center(Grid(1, 1, 0.5)), s.local_pose.value.yaw)  # kitchen.koord:142
    for my_k in turns(keys(s.shared_names.value)):  # kitchen.koord:143
        if map_at(s.shared_names.value, my_k) == map_at(PARAM_LABELS, 1) and not has_key(PARAM_LABELS, my_k) and my_k not in looked(keys(s.shared_names.value)):  # kitchen.koord:144
            s.shared_names.value = map_without(s.shared_names.value, my_k)  # kitchen.koord:145
    for my_k_2, my_v in turns(s.shared_names.value):  # kitchen.koord:146
        s.local_text.value = my_v if my_k_2 > 1 else at(s.local_text.value, 0)  # kitchen.koord:147
    s.shared_waiting.value = without(s.shared_waiting.value, 0)  # kitchen.koord:148


def guard_finish(s: State) -> bool:
    """pre of Finish, kitchen.koord:150"""
    return s.local_count.value >= PARAM_LAPS or s.shared_done.value  # kitchen.koord:151


def effect_finish(s: State) -> None:
    """eff of Finish, kitchen.koord:150"""
    s.shared_done.value = True  # kitchen.koord:153
    s.local_on.value = False  # kitchen.koord:154
    s.local_spot.value = s.motion_target.value  # kitchen.koord:155
    raise Stopped  # kitchen.koord:156


# Line of this file -> line of kitchen.koord.
LINES: dict[int, int] = {68: 36, 69: 37, 70: 38, 71: 39, 72: 40, 131: 18, 132: 19, 133: 20, 134: 21, 135: 22, 136: 23, 141: 25, 142: 26, 143: 27, 144: 28, 145: 29, 146: 30, 147: 31, 148: 32, 153: 34, 154: 34, 158: 80, 159: 81, 160: 82, 165: 85, 170: 87, 171: 88, 172: 89, 173: 90, 174: 91, 176: 93, 177: 94, 178: 95, 179: 96, 180: 97, 181: 98, 186: 101, 191: 103, 192: 104, 193: 105, 194: 106, 195: 107, 196: 108, 197: 109, 198: 110, 199: 111, 200: 112, 201: 113, 202: 114, 203: 115, 204: 116, 205: 117, 206: 117, 207: 118, 208: 119, 209: 120, 210: 121, 211: 122, 212: 123, 213: 124, 214: 125, 215: 125, 216: 126, 217: 127, 218: 128, 219: 129, 224: 132, 229: 134, 230: 135, 231: 136, 232: 137, 233: 138, 234: 139, 235: 140, 236: 141, 237: 142, 238: 143, 239: 144, 240: 145, 241: 146, 242: 147, 243: 148, 248: 151, 253: 153, 254: 154, 255: 155, 256: 156, 268: 66, 269: 67, 270: 68, 271: 69, 272: 70, 273: 71, 274: 72, 275: 73, 276: 74, 277: 75, 278: 76, 279: 77, 282: 57, 283: 58, 284: 59, 285: 61, 286: 62, 287: 63, 288: 64}

PROGRAM = Program(
    name="kitchen",
    source="kitchen.koord",
    program_hash="e6936348b9edc9c9",
    interface_hash="fdb0b0d0da7d441f",
    locals=(
        Variable("count", "local", int, Fixed(9), lambda: 0),  # kitchen.koord:66
        Variable("level", "local", float, Fixed(9), lambda: PARAM_MARGIN * 2.0),  # kitchen.koord:67
        Variable("on", "local", bool, Fixed(1), lambda: True),  # kitchen.koord:68
        Variable("spot", "local", Point, Fixed(28), lambda: PARAM_HOME),  # kitchen.koord:69
        Variable("seen", "local", tuple[tuple[int, bool], ...], Distinct(4096, Parts((Fixed(9), Fixed(1)))), lambda: ()),  # kitchen.koord:70
        Variable("known", "local", GridMap, Cells(100), lambda: area(Point(0.0, 0.0, 0.0), Point(5.0, 5.0, 0.0), 0.5)),  # kitchen.koord:71
        Variable("scan", "local", Scan, Rays(4096), lambda: Scan()),  # kitchen.koord:72
        Variable("pose", "local", Pose, Fixed(38), lambda: Pose(PARAM_HOME, 3.141592653589793 / 2.0)),  # kitchen.koord:73
        Variable("tray", "local", Tray, Parts((Parts((Fixed(28), Text(16), Fixed(9)), ("at", "name", "size")), Many(3, Parts((Fixed(28), Text(16), Fixed(9)), ("at", "name", "size"))), Parts((Fixed(9), Text(256)))), ("first", "class_", "None_")), lambda: Tray(Cup(Point(1.0, 2.0, 3.0), "it's a \"cup\"", 0), (), (0, ""))),  # kitchen.koord:74
        Variable("ticket", "local", Ticket, Blob(256, "Ticket"), lambda: Opaque()),  # kitchen.koord:75
        Variable("text", "local", str, Text(4096), lambda: ""),  # kitchen.koord:76
        Variable("levels", "local", tuple[float, ...], Many(4096, Fixed(9)), lambda: (1.0, 2.5)),  # kitchen.koord:77
    ),
    shared=(
        Variable("x", "allread", Point, Fixed(28), lambda: Point(0.0, 0.0, 0.0)),  # kitchen.koord:57
        Variable("class", "allread", int, Fixed(9), lambda: -1),  # kitchen.koord:58
        Variable("paths", "allread", tuple[Point, ...], Many(3, Fixed(28)), lambda: ()),  # kitchen.koord:59
        Variable("lowest", "allwrite", float, Fixed(9), lambda: 1000.0),  # kitchen.koord:61
        Variable("done", "allwrite", bool, Fixed(1), lambda: False),  # kitchen.koord:62
        Variable("names", "allwrite", tuple[tuple[int, str], ...], Pairs(3, Fixed(9), Text(8)), lambda: ()),  # kitchen.koord:63
        Variable("waiting", "allwrite", tuple[Cup, ...], Many(2, Parts((Fixed(28), Text(16), Fixed(9)), ("at", "name", "size"))), lambda: ()),  # kitchen.koord:64
    ),
    ports=(
        Port("Motion.position", "sensor", Point, is_position=True),
        Port("Motion.reached", "sensor", bool),
        Port("Motion.pscan", "sensor", tuple[tuple[Point, Scan], ...]),
        Port("Motion.target", "actuator", Point, Fixed(28), lambda: Point(), held="Motion.position", clears=("Motion.reached",)),
        Port("Motion.path", "actuator", tuple[Point, ...], Many(4096, Fixed(28)), lambda: (), clears=("Motion.reached",)),
        Port("Motion.planner", "callable", tuple[Point, ...]),
        Port("Log.stdout", "stream", str),
    ),
    init=init,
    events=(
        Event("Advance", 84, guard_advance, effect_advance),
        Event("Collect", 100, guard_collect, effect_collect),
        Event("Plan", 131, guard_plan, effect_plan, 0),
        Event("Finish", 150, guard_finish, effect_finish),
    ),
    begin=State,
    file=__file__,
    lines=LINES,
    locks=(("paths", "names", "waiting"),),
    library=LIBRARY,
)
