"""Time of port calls: warns if the calls of one event may take more than half of a round."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf
from typing import assert_never

from koordgen.lang.diagnostics import Diagnostic
from koordgen.lang.ir import expr, stmt
from koordgen.lang.ir.decl import Event, Program
from koordgen.lang.ir.tree import walk
from koordgen.lang.ir.types import MapOf, PerRobot, Sequence
from koordgen.lang.node import Node

SHORTEST, LONGEST = 0.01, 0.06  # seconds: bounds of the default of `planner_budget`
# Share of a round that the port calls of one event may take together. An event must end at half of the round, the
# publish deadline, and needs time for its other work.
SHARE = 0.4

Calls = list[tuple[expr.PortCall, float]]  # pairs: a call, and how often an event makes the call at most
_AS_LONG = ("sorted", "reversed", "keys", "values", "items")  # functions whose result is as long as their argument


def check_calls(program: Program, robots: int, delta: float, budget: float) -> list[Diagnostic]:
    """Return a warning for each event whose port calls may take more than half of a round.

    `delta`: seconds of a round. `budget`: seconds of one call. The warning points at the most frequent call.
    """
    counting = _CallCounter(program, robots)
    return [d for event in program.events for d in _check(event, counting.block(event.effect, 1), delta, budget)]


def planner_budget(program: Program, robots: int, delta: float, given: float | None) -> float:
    """Return the seconds that each call of a port may take.

    `given` is the value of the fleet file. Without it: SHARE of a round, divided among the calls of the event with
    most calls, within SHORTEST and LONGEST.
    """
    if given is not None:
        return given
    counting = _CallCounter(program, robots)
    most = max((_number(counting.block(event.effect, 1)) for event in program.events), default=0)
    return round(max(SHORTEST, min(LONGEST, SHARE * delta / max(most, 1))), 4)


def _check(event: Event, found: Calls, delta: float, budget: float) -> Iterator[Diagnostic]:
    number = _number(found)
    if number * budget <= delta / 2 + 1e-9:
        return
    call, _ = min(found, key=lambda each: (-each[1], each[0].span.line, each[0].span.column))
    port = f"{call.module}.{call.port}"
    if number == inf:
        message = f"{event.name} calls {port} in a loop without a visible bound; each call may take {_ms(budget)}"
    else:
        sum_ = f"{number:g} x {_ms(budget)} = {_ms(number * budget)}"
        message = f"{event.name} may take longer than half of a round: up to {number:g} port calls, {sum_}"
    fits = int(delta / 2 / budget + 1e-9)
    calls = f"{fits} calls fit" if fits != 1 else "1 call fits"
    help = f"{calls} into half of a round of {_ms(delta)}: loop over a list that is declared with a smaller 'max'"
    if number < inf:
        quick = _ms(delta / 2 / number)
        help += f", or set planner_budget in the fleet file to {quick} or less if the planner can keep it"
    message += f"; half of a round is {_ms(delta / 2)}"
    yield Diagnostic("B007", "warning", message, call.span, help=help)


def _number(found: Calls) -> float:
    return sum(times for _, times in found)


def _ms(seconds: float) -> str:
    return f"{seconds * 1e3:.4g} ms" if seconds < 10 else f"{seconds:.0f} s"


class _CallCounter:
    """Upper bound of the port calls of a block. `break`, `return` and `stop` are ignored, which only adds calls."""

    def __init__(self, program: Program, robots: int) -> None:
        self.params = {p.name: p.default for p in program.params}
        self.robots = robots

    def block(self, block: stmt.Block, times: float) -> Calls:
        return [call for statement in block for call in self.statement(statement, times)] if times else []

    def statement(self, statement: stmt.Stmt, times: float) -> Calls:
        match statement:
            case stmt.If(condition, then, orelse):
                ways = self.block(then, times), self.block(orelse, times)
                return [*_calls(condition, times), *max(ways, key=_number)]
            case stmt.For(values=values, block=inner):
                return [*_calls(values, times), *self.block(inner, times * self.turns(values))]
            case stmt.While(condition, inner):
                return [*_calls(condition, times * inf), *self.block(inner, times * inf)]
            case (
                stmt.Assign() | stmt.Let() | stmt.Return() | stmt.Emit() | stmt.Break() | stmt.Continue() | stmt.Stop()
            ):
                return _calls(statement, times)
            case _:
                assert_never(statement)

    def turns(self, values: expr.Expr) -> float:
        """Return the greatest number of turns of a loop over `values`."""
        match values:
            case expr.Range(start, stop, step):
                low, high = self.constant(start), self.constant(stop)
                if high is None and step > 0 and isinstance(stop, expr.Builtin) and stop.name == "len":
                    return max(0, -(-(self.turns(stop.args[0]) - (low or 0)) // step))
                return inf if low is None or high is None else len(range(low, high, step))
            case expr.Ids():
                return self.robots
            case expr.Make(items):
                return len(items)
            case expr.Slice(operand, _, stop):
                end = None if stop is None else self.constant(stop)
                return min(self.turns(operand), inf if end is None else max(0, end))
            case expr.Builtin(name, (of, *_)) if name in _AS_LONG:
                return self.turns(of)
            case _:
                held = values.type
                most = held.capacity if isinstance(held, (Sequence, MapOf)) else inf
                return self.robots if isinstance(held, PerRobot) else most

    def constant(self, node: expr.Expr) -> int | None:
        """Return the value of an int expression if it is constant in this build, otherwise None."""
        match node:
            case expr.Const(int(value)):
                return value
            case expr.ParamRead(name):
                return self.constant(self.params[name])
            case expr.NSys():
                return self.robots
            case expr.Unary("-", operand):
                value_ = self.constant(operand)
                return None if value_ is None else -value_
            case _:
                return None


def _calls(root: Node, times: float) -> Calls:
    """Return the port calls in an expression or a statement. Blocks inside a statement are left out."""
    return [(node, times) for node in walk(root) if isinstance(node, expr.PortCall)]
