"""Whether a `forall` over robots is one of which each robot can tell nothing but for itself.

    forall i in ID: Motion.position[i] in box                   yes: of others' positions no robot knows
    forall i in ID: leader[i] < 0 or bid[j] >= 0                yes, for i: what stands first is not known of others
    forall i in ID: i == j or distance(position[i], x[j]) > 1   yes: for some other i, and for none is it false
    forall i in ID: x[i] > 0                                    no: all know an allread variable

Then a monitor evaluates its own robot's instance alone: one robot's formula costs no more in a large fleet.
"""

from __future__ import annotations

from typing import NamedTuple

from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.tree import children
from koordgen.lang.node import Node


class _May(NamedTuple):
    """What a formula may come to; neither, when it surely asks for what is not known."""

    be_true: bool
    be_false: bool


_UNKNOWN, _ANY = _May(False, False), _May(True, True)


def tells_of_itself(node: ir.Quantified) -> bool:
    """Of a `forall`: whether no other robot's instance can be seen to be false, and at least one not to be true."""
    if node.kind != "forall" or not isinstance(node.domain, ir.Ids):
        return False
    return not _may(node.body, node.name, True).be_true and not _may(node.body, node.name, False).be_false


def _may(node: ir.Expr, robot: str, distinct: bool) -> _May:
    """`robot` names one of which ports and locals are not known; `distinct`: it is none of the other names' robots."""
    match node:
        case ir.Unary("not", operand):
            found = _may(operand, robot, distinct)
            return _May(found.be_false, found.be_true)
        case ir.Logic("or", left, right):
            first, second = _may(left, robot, distinct), _may(right, robot, distinct)
            return _May(first.be_true or (first.be_false and second.be_true), first.be_false and second.be_false)
        case ir.Logic("and", left, right):
            first, second = _may(left, robot, distinct), _may(right, robot, distinct)
            return _May(first.be_true and second.be_true, first.be_false or (first.be_true and second.be_false))
        case ir.Quantified("forall", _, domain, body) if not _asks(domain, robot):
            found = _may(body, robot, distinct)
            return found if isinstance(domain, ir.Ids) else _May(True, found.be_false)
        case ir.Compare("==" | "!=" as op, ir.TempRead(one), ir.TempRead(other)) if distinct and robot in (one, other):
            return _May(op == "!=", op == "==") if one != other else _ANY
        case _:
            return _UNKNOWN if _asks(node, robot) else _ANY


def _asks(node: Node, robot: str) -> bool:
    """Whether its value is never had without a port or a local of that robot."""
    match node:
        case ir.LocalOf(_, ir.TempRead(at)) | ir.PortOf(_, _, ir.TempRead(at)) if at == robot:
            return True
        case ir.Logic(_, left, _):
            return _asks(left, robot)
        case ir.Conditional(condition, then, orelse):
            return _asks(condition, robot) or (_asks(then, robot) and _asks(orelse, robot))
        case ir.Quantified(_, _, domain, _):
            return _asks(domain, robot)
        case _:
            return any(_asks(part, robot) for part in children(node))
