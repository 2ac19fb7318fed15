"""Sums over what all robots have: of a fleet where one robot's changed, the sum without the old, with the new."""

from __future__ import annotations

from collections.abc import Callable

from koordgen.verify.prove.encode.encoder import ExprEncoder
from koordgen.verify.prove.encode.values import Fleet, Val
from koordgen.verify.prove.smt import term as t
from koordgen.verify.prove.smt.term import Function, Term


def folded(
    e: ExprEncoder, xs: Fleet, name: str, extra: tuple[Term, ...], part: Callable[[Val], Term], zero: Term
) -> Term:
    """The sum of `part` over all robots. For any number of robots it is a function of the fleet, and this is told of
    it: it is zero where all parts are, not negative where none is, at most N_SYS where none is above one, at least
    that where none is below; a count is that of the other robots, and this one."""
    room = e.room
    found: Term = zero
    if room.robots is not None:
        for robot in range(room.robots):
            found = t.add(found, part(xs.slot(t.integer(robot))))
        return found
    if xs.changed is not None:
        before, robot_, value = xs.changed
        rest = t.subtract(folded(e, before, name, extra, part, zero), part(before.slot(robot_)))
        found = t.add(rest, part(value))
    else:
        whole = e.lists.term(xs)
        domain = (whole.sort, *[x.sort for x in extra])
        found = t.apply(Function(f"{xs.type}.{name}", domain, zero.sort), whole, *extra)
    if found not in room.folds:
        room.folds.add(found)
        with room.about(f"{name} over all robots", 0):
            _bounded(e, xs, name, part, found)
    return found


def _bounded(e: ExprEncoder, xs: Fleet, name: str, part: Callable[[Val], Term], found: Term) -> None:
    room, real = e.room, found.sort is t.REAL
    zero, one = (t.real(0), t.real(1)) if real else (t.integer(0), t.integer(1))
    most = t.to_real(room.size) if real else room.size
    wrongs: tuple[tuple[Term, Callable[[Term], Term]], ...] = (
        (t.equals(found, zero), lambda x: t.not_(t.equals(x, zero))),
        (t.at_most(zero, found), lambda x: t.less(x, zero)),
        (t.at_most(found, most), lambda x: t.less(one, x)),
        (t.at_most(most, found), lambda x: t.less(x, one)),
    )
    for holds, wrong in wrongs:
        some = room.new(name, t.INT)
        room.robot(some, witness=True)
        room.fact(t.or_(holds, t.and_(room.within(some), wrong(part(xs.slot(some))))))

    def without(robot: Term) -> Term:
        others = t.subtract(found, part(xs.slot(robot)))
        return t.implies(room.within(robot), t.and_(t.at_most(zero, others), t.less(others, most)))

    if name == "count":
        room.for_all(without)
