"""Own-instance analysis: finds each `forall` over robots that a robot can evaluate for itself only.

A robot does not know ports and locals of other robots. If instances for other robots cannot be false on a robot, the
robot's monitor evaluates its own instance alone, at a cost that does not grow with the fleet.

    forall i in ID: Motion.position[i] in box                   yes: no robot knows the positions of others
    forall i in ID: leader[i] < 0 or bid[j] >= 0                yes: evaluation stops at the unknown leader[i]
    forall i in ID: i == j or distance(position[i], x[j]) > 1   yes: true for i == j, unknown for another i, never false
    forall i in ID: x[i] > 0                                    no: every robot knows an allread variable
"""

from __future__ import annotations

from typing import NamedTuple

from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.tree import children
from koordgen.lang.node import Node


class _Possible(NamedTuple):
    """Possible truth values of a formula. Both are False if every evaluation of the formula needs an unknown value."""

    be_true: bool
    be_false: bool


_UNKNOWN, _ANY = _Possible(False, False), _Possible(True, True)


def is_own_instance_enough(node: ir.Quantified) -> bool:
    """Return whether a robot need evaluate only its own instance of a `forall` over robots.

    This is so if, as far as this robot knows, the instance of another robot is never false, and is never true if no
    other name in the formula denotes that robot. The value of such an instance is unknown.
    """
    if node.kind != "forall" or not isinstance(node.domain, ir.Ids):
        return False
    return not _possible(node.body, node.name, True).be_true and not _possible(node.body, node.name, False).be_false


def _possible(node: ir.Expr, robot: str, distinct: bool) -> _Possible:
    """Return the possible truth values of a formula in which ports and locals of `robot` are unknown.

    `robot` is the name of a quantified robot. `distinct`: no other name in the formula denotes the same robot.
    """
    match node:
        case ir.Unary("not", operand):
            found = _possible(operand, robot, distinct)
            return _Possible(found.be_false, found.be_true)
        case ir.Logic("or", left, right):
            first, second = _possible(left, robot, distinct), _possible(right, robot, distinct)
            return _Possible(first.be_true or (first.be_false and second.be_true), first.be_false and second.be_false)
        case ir.Logic("and", left, right):
            first, second = _possible(left, robot, distinct), _possible(right, robot, distinct)
            return _Possible(first.be_true and second.be_true, first.be_false or (first.be_true and second.be_false))
        case ir.Quantified("forall", _, domain, body) if not _needs(domain, robot):
            found = _possible(body, robot, distinct)
            return found if isinstance(domain, ir.Ids) else _Possible(True, found.be_false)
        case ir.Compare("==" | "!=" as op, ir.TempRead(one), ir.TempRead(other)) if distinct and robot in (one, other):
            return _Possible(op == "!=", op == "==") if one != other else _ANY
        case _:
            return _UNKNOWN if _needs(node, robot) else _ANY


def _needs(node: Node, robot: str) -> bool:
    """Return whether the evaluation of `node` always reads a port or a local variable of the robot named `robot`."""
    match node:
        case ir.LocalOf(_, ir.TempRead(at)) | ir.PortOf(_, _, ir.TempRead(at)) if at == robot:
            return True
        case ir.Logic(_, left, _):
            return _needs(left, robot)
        case ir.Conditional(condition, then, orelse):
            return _needs(condition, robot) or (_needs(then, robot) and _needs(orelse, robot))
        case ir.Quantified(_, _, domain, _):
            return _needs(domain, robot)
        case _:
            return any(_needs(part, robot) for part in children(node))
