"""Whether instances at the terms that name robots are all that count: the conditions of completeness.

Either every formula speaks of one robot at a time, by its variables alone: then a model of the instances becomes one of
all robots when those not spoken of are copies of one that is. Or robots are told apart by equality and order only: then
those not spoken of are left out, and the others renumbered.
"""

from __future__ import annotations

from koordgen.lang.ir import decl, stmt
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.tree import walk
from koordgen.lang.ir.types import INT


def complete(program: decl.Program) -> bool:
    """Whether a model of the instances is a model of the formulas."""
    formulas = [p.formula for p in program.properties if p.kind != "axiom"]
    loops = [n for f in program.functions for n in walk(f.block) if type(n).__name__ in ("For", "While")]
    if not loops and all(_one_at_a_time(formula) for formula in formulas):
        return True
    return not any(_reckons(node) for node in walk((program.events, program.init, program.functions)))


def _one_at_a_time(formula: ir.Expr) -> bool:
    """Whether no quantifier stands within another or under anything but `and`, and its variable only names a robot."""
    match formula:
        case ir.Logic("and", left, right):
            return _one_at_a_time(left) and _one_at_a_time(right)
        case ir.Quantified("forall", name, ir.Ids(), body):
            inner = list(walk(body))
            uses = sum(isinstance(n, ir.TempRead) and n.name == name for n in inner)
            named = sum(_names(n, name) for n in inner)
            return uses == named and not any(isinstance(n, (ir.Quantified, ir.SlotsRead)) for n in inner)
        case _:
            return not any(isinstance(n, (ir.Quantified, ir.SlotsRead)) for n in walk(formula))


def _names(node: object, name: str) -> bool:
    match node:
        case (
            ir.LocalOf(_, ir.TempRead(found)) | ir.PortOf(_, _, ir.TempRead(found)) | ir.SlotRead(_, ir.TempRead(found))
        ):
            return found == name
        case _:
            return False


def _reckons(node: object) -> bool:
    """Whether an int that may name a robot, or the number of robots, is reckoned with, kept, or compared with what is
    none."""
    match node:
        case ir.Binary(_, left, right) if left.type == INT:
            return any(map(_may_name, walk((left, right))))
        case ir.Widen(operand):
            return any(map(_may_name, walk(operand)))
        case ir.Compare(_, left, right) if left.type == INT:
            return any(map(_may_name, walk((left, right)))) and not (_may_name(left) and _may_name(right))
        case stmt.Assign(_, value) | stmt.Let(_, _, value) if value.type == INT:
            return any(map(_may_name, walk(value)))
        case ir.SlotsRead() | ir.ExternCall() | ir.Range():
            return True
        case _:
            return False


def _may_name(node: object) -> bool:
    return isinstance(node, (ir.Pid, ir.NSys)) or (isinstance(node, ir.TempRead) and node.type == INT)
