"""kitchen: the properties of the Koord program kitchen.koord, by koordgen 0.1.0.

The next build overwrites this file: change the Koord program instead.
"""

from __future__ import annotations

from typing import Any

from koordgen.runtime.program.property import (
    Assumption, Each, GoalCall, Known, One, Properties, Property, Trail, Unchecked
)
from koordgen.runtime.values.containers import last
from koordgen.runtime.values.gridmap import GridMap
from koordgen.runtime.values.points import Point, Pose, Scan, distance, no_nan_in
from koordgen.runtime.values.region import Ball, Rect
from koordgen.runtime.values.turns import looked, turns

from program import Cup, PARAM_HOME, PARAM_MARGIN, PROGRAM, Ticket, Tray, fun_heavy

# As in program.py. Where a line says "discards the event", a formula has no value:
#   at(xs, i)         is xs[i]; i < 0 or i >= len(xs) discards the event
#   no_nan(x)         is x; NaN discards the event, where a comparison alone would be false
#   turns(xs)         is xs, and counts turns: an event has at most a million turns and calls
#   made(xs)          is xs, and counts a turn for each 100 elements; so does looked(xs)
#   f(a) + g(b)       calls f first: operands are evaluated from left to right, as in Koord


class Fleet(Known):
    """State of all robots at one time, for the properties of kitchen."""

    def __init__(self, n_sys: int, trail: Trail | None = None) -> None:
        super().__init__(n_sys, trail)
        self.motion_position: Each[Point] = self.of_each("Motion.position")
        self.motion_reached: Each[bool] = self.of_each("Motion.reached")
        self.motion_pscan: Each[tuple[tuple[Point, Scan], ...]] = self.of_each("Motion.pscan")
        self.motion_target: Each[Point] = self.of_each("Motion.target")
        self.motion_path: Each[tuple[Point, ...]] = self.of_each("Motion.path")
        self.shared_x: Each[Point] = self.of_each("x")
        self.shared_class: Each[int] = self.of_each("class")
        self.shared_paths: Each[tuple[Point, ...]] = self.of_each("paths")
        self.shared_lowest: One[float] = self.of_one("lowest")
        self.shared_done: One[bool] = self.of_one("done")
        self.shared_names: One[tuple[tuple[int, str], ...]] = self.of_one("names")
        self.shared_waiting: One[tuple[Cup, ...]] = self.of_one("waiting")
        self.local_count: Each[int] = self.of_each("count")
        self.local_level: Each[float] = self.of_each("level")
        self.local_on: Each[bool] = self.of_each("on")
        self.local_spot: Each[Point] = self.of_each("spot")
        self.local_seen: Each[tuple[tuple[int, bool], ...]] = self.of_each("seen")
        self.local_known: Each[GridMap] = self.of_each("known")
        self.local_scan: Each[Scan] = self.of_each("scan")
        self.local_pose: Each[Pose] = self.of_each("pose")
        self.local_tray: Each[Tray] = self.of_each("tray")
        self.local_ticket: Each[Ticket] = self.of_each("ticket")
        self.local_text: Each[str] = self.of_each("text")
        self.local_levels: Each[tuple[float, ...]] = self.of_each("levels")


class Ports:
    """One robot's ports."""

    def __init__(self, known: Known, prime: str = "") -> None:
        self.motion_position: One[Point] = known.of_one("Motion.position" + prime)
        self.motion_reached: One[bool] = known.of_one("Motion.reached" + prime)
        self.motion_pscan: One[
            tuple[tuple[Point, Scan], ...]
        ] = known.of_one("Motion.pscan" + prime)
        self.motion_target: One[Point] = known.of_one("Motion.target" + prime)
        self.motion_path: One[tuple[Point, ...]] = known.of_one("Motion.path" + prime)


class Step(Known):
    """Ports of one robot for assumptions: `before` has the values right after the program's step,
    `after` has the values at a later time of the same round."""

    def __init__(self, n_sys: int, trail: Trail | None = None) -> None:
        super().__init__(n_sys, trail)
        self.before = Ports(self)
        self.after = Ports(self, "'")

    def motion_planner(self, *args: Any) -> tuple[Point, ...]:
        """A call of "Motion.planner" in the program."""
        found: tuple[Point, ...] = self.answer("Motion.planner", args)
        return found


def initially(s: Fleet) -> bool:
    """initially, kitchen.koord:160"""
    return s.own(
        "i",
        lambda my_i: s.own(
            "j",
            lambda my_j: (
                my_i == my_j
                or distance(s.motion_position[my_i], s.motion_position[my_j]) > PARAM_MARGIN
            ),
        ),
    )


def invariant_fenced(s: Fleet) -> bool:
    """invariant Fenced, kitchen.koord:161"""
    return s.own(
        "i",
        lambda my_i: (
            s.motion_position[my_i] in Ball(PARAM_HOME, 10.0)
            and (
                not s.local_on[my_i]
                or s.some(
                    "j",
                    turns(range(1, s.n_sys)),
                    lambda my_j: s.shared_paths[my_j] == s.shared_paths[my_i],
                )
            )
        ),
    )


def invariant_sized(s: Fleet) -> bool:
    """invariant Sized, kitchen.koord:162"""
    return s.every(
        "c",
        turns(s.shared_waiting.value),
        lambda my_c: fun_heavy(my_c) or my_c.size <= 3,
        robots=False,
    )


def invariant_class(s: Fleet) -> bool:
    """invariant Class, kitchen.koord:163"""
    return (
        s.shared_done.value
        or (
            len(s.shared_x.all) == s.n_sys
            and s.every(
                "i",
                range(s.n_sys),
                lambda my_i: (
                    s.shared_class[my_i] >= -1 and s.local_spot[my_i] != Point(0.0, 0.0, 9.0)
                ),
            )
        )
    )


def assume_motion(s: Step) -> bool:
    """assume of Motion, kitchen.koord:51"""
    return (
        s.after.motion_position.value in Rect(
            s.before.motion_position.value, s.before.motion_target.value
        )
        or distance(s.after.motion_position.value, s.before.motion_target.value) <= PARAM_MARGIN
    )


def screening_assume_motion(b: Any) -> Any:
    """Screening of many observations at once: the formula holds wherever the result is true."""
    return b.either(
        b.in_rect(
            b.each("Motion.position'", 0), b.each("Motion.position", 0), b.each("Motion.target", 0)
        ),
        b.over(PARAM_MARGIN, b.distance(b.each("Motion.position'", 0), b.each("Motion.target", 0))),
    )


def assume_motion_2(s: Step, my_goal: Point) -> bool:
    """assume of Motion, kitchen.koord:52"""
    return (
        looked(s.motion_planner(my_goal)) == ()
        or last(s.motion_planner(my_goal)) == no_nan_in(my_goal)
    )


PROPERTIES = Properties(
    program=PROGRAM,
    fleet=Fleet,
    step=Step,
    properties=(
        Property(kind="initially", name="", line=160, holds=initially, reads=("Motion.position",)),
        Property(
            kind="invariant",
            name="Fenced",
            line=161,
            holds=invariant_fenced,
            reads=("Motion.position", "on", "paths"),
        ),
        Property(
            kind="invariant", name="Sized", line=162, holds=invariant_sized, reads=("waiting",)
        ),
        Property(
            kind="invariant",
            name="Class",
            line=163,
            holds=invariant_class,
            reads=("done", "x", "class", "spot"),
        ),
    ),
    assumptions=(
        Assumption(
            module="Motion",
            line=51,
            holds=assume_motion,
            reads=("Motion.position'", "Motion.position", "Motion.target"),
            goals=(),
            screening=screening_assume_motion,
        ),
        Assumption(
            module="Motion",
            line=52,
            holds=assume_motion_2,
            reads=(),
            goals=(GoalCall(port="Motion.planner", arguments=1, goals={0: "my_goal"}),),
        ),
    ),
    unchecked=(
        Unchecked(kind="axiom", name="Home", line=159, why="an axiom is assumed"),
        Unchecked(
            kind="invariant",
            name="Calm",
            line=164,
            why="calm (line 158) is a spec fun, which only axioms describe",
        ),
    ),
    measured=("Motion.position",),
)
