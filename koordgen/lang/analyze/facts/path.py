"""Program points and the conditions passed on the path to them.

The facts at a point are computed on demand: most points never need them, and computing them would take most of the time
of a check.
"""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Set as AbstractSet
from typing import Any

from koordgen.lang.analyze.facts import linear
from koordgen.lang.analyze.facts.linear import Formula
from koordgen.lang.analyze.facts.terms import Flow, after_assignment, formula
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir import stmt


class Path:
    """Program point, with the points before it on the paths through the program."""

    __slots__ = ("_before", "_flow", "_step")

    def __init__(self, before: tuple[Path, ...] = (), step: Callable[..., Flow] = Flow) -> None:
        self._before = before
        self._step = step  # computes the facts at this point from those at earlier points
        self._flow: Flow | None = None

    @property
    def flow(self) -> Flow:
        """Facts known at this point."""
        if self._flow is None:
            self._compute()
        assert self._flow is not None
        return self._flow

    def _compute(self) -> None:
        """Compute the facts of this point.

        The computation is iterative, because a recursion over a long event would exceed Python's stack.
        """
        pending = [self]
        while pending:
            path = pending[-1]
            missing = [p for p in path._before if p._flow is None]
            pending.extend(missing)
            if not missing:
                pending.pop()
                if path._flow is None:
                    path._flow = path._step(*[p._flow for p in path._before])
                    path._before, path._step = (), Flow

    def passing(self, condition: Condition) -> Path:
        """Return the next point on the path on which a condition, evaluated at this point, is true."""
        return Path((self,), lambda flow: flow.assuming(condition.formula))

    def failing(self, condition: Condition) -> Path:
        """Return the next point on the path on which a condition, evaluated at this point, is false."""
        return Path((self,), lambda flow: flow.assuming(linear.negate(condition.formula)))

    def assigning(self, place: stmt.Place, value: ir.Expr) -> Path:
        """Return the point after the assignment `place = value`."""
        return Path((self,), lambda flow: after_assignment(flow, place, value))


class Condition:
    """Typed condition of the program at a point. Its formula is computed on demand."""

    __slots__ = ("_formula", "_path", "node")

    def __init__(self, node: ir.Expr, path: Path) -> None:
        self.node = node
        self._path = path
        self._formula: Formula | None = None

    @property
    def formula(self) -> Formula:
        """Formula of this condition: always the same object, so that formulas can be compared by identity."""
        if self._formula is None:
            self._formula = formula(self.node, self._path.flow)
        return self._formula


def point_with_facts(flow: Flow) -> Path:
    """Return a program point at which the given facts are known."""
    path = Path()
    path._flow = flow
    return path


def joined(ends: list[Path | None]) -> Path | None:
    """Return the point where several paths meet; None if no path is reachable."""
    reached = tuple(dict.fromkeys([end for end in ends if end is not None]))
    return Path(reached, _join) if len(reached) > 1 else reached[0] if reached else None


def _join(*flows: Any) -> Flow:
    result: Flow = flows[0]
    for flow in flows[1:]:
        result = result.joined(flow)
    return result


# Conditions that need no analysis


def is_open(condition: ir.Expr, mentioned: AbstractSet[str]) -> bool:
    """Return whether a condition and its negation are both possible, by a quick test of its form.

    Returns True if the condition only compares literal numbers with variables, names each variable once, and no
    variable is in `mentioned`, so that no facts about the variables exist. The result False means that the condition
    must be analysed.
    """
    names: list[str] = []
    return _is_free(condition, names) and len(names) == len(set(names)) and mentioned.isdisjoint(names)


def _is_free(node: ir.Expr, names: list[str]) -> bool:
    """Return whether a condition only compares literal numbers with variables. Adds the variables to `names`."""
    kind = type(node)
    if kind is ir.Logic:
        return _is_free(node.left, names) and _is_free(node.right, names)  # type: ignore[union-attr]
    if kind is ir.Unary:
        return _is_free(node.operand, names)  # type: ignore[union-attr]
    if kind is ir.Compare:
        left, right = node.left, node.right  # type: ignore[union-attr]
        if type(left) is ir.Pid and type(right) is ir.Const:
            # The fleet may have any size, so every pid >= 0 belongs to some robot of some fleet. No pid is below 0.
            names.append("pid")
            return right.value >= (1 if node.op in ("<", ">=") else 0)  # type: ignore[union-attr, operator]
        node = left.operand if type(left) is ir.Widen else left
        kind = type(node) if _is_number(right) else None  # type: ignore[assignment]
    if kind is ir.LocalRead or kind is ir.SharedRead:
        names.append(node.name)  # type: ignore[union-attr]
        return True
    return False


def _is_number(node: ir.Expr) -> bool:
    kind = type(node)
    if kind is ir.Const:
        return type(node.value) is not str  # type: ignore[union-attr]
    if kind is ir.Widen:
        return _is_number(node.operand)  # type: ignore[union-attr]
    return kind is ir.Binary and node.op in ("+", "-", "*") and _is_number(node.left) and _is_number(node.right)  # type: ignore[union-attr]
