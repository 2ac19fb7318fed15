"""K041, unless K042 is reported: events that wait for a bool that only waiting events change.

Such events can never run. Events that another rule has reported, as K041 or K042, are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from koordgen.lang.diagnostics import Label
from koordgen.lang.ir import decl, stmt
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.tree import statements
from koordgen.lang.ir.types import BOOL
from koordgen.lang.reporter import Reporter

Starts = Mapping[str, object]  # name of a local bool -> its initial value


def check_waiting(program: decl.Program, is_whole: Callable[[], bool], reporter: Reporter) -> None:
    """Warn of each event that waits for a local bool variable that only waiting events change.

    An event waits for a bool variable if its guard needs the variable to differ from its initial value. A variable that
    no event sets is not reported: such a variable is a switch that the author sets in the program's text. `is_whole`
    returns whether all of the text could be parsed.
    """
    starts = {v.name: v.initial.value for v in program.locals if v.type is BOOL and type(v.initial) is ir.Const}
    events = program.events
    asked = [_needed_flags(event.guard, starts) for event in events]
    if not any(asked) or reporter.has_errors():
        return
    stuck = _unchanged_flags(asked, program.init, events, starts)
    if not stuck or not is_whole():
        return
    makers: dict[str, list[str]] = {flag: [] for flag in stuck}
    for event in events:
        for flag in _changed_flags(event.effect, starts) & stuck:
            makers[flag].append(event.name)
    reported = {(d.span.line, d.span.column) for d in reporter.found if d.code in ("K041", "K042")}
    spans = {v.name: v.span for v in program.locals}
    for event, flags in zip(events, asked, strict=True):
        own = min(flags & stuck, default=None)
        if own is None or not reported.isdisjoint((s.line, s.column) for s in (event.span, event.guard.span)):
            continue
        who = f"only {makers[own][0]} makes" if len(makers[own]) == 1 else "only events that can never run make"
        old, new = starts[own], not starts[own]
        message = f"the event {event.name} can never run: {own} starts {old}, and {who} it {new}"
        help = f"set {own} to {new} in init or another event, or change the guard to '{own if old else f'not {own}'}'"
        reporter.warn("K041", message, event.guard.span, help, (Label(spans[own], f"starts {old}"),))


def _needed_flags(guard: ir.Expr, starts: Starts) -> set[str]:
    """Return the bool variables that must differ from their initial values for a guard to hold.

    Only the conditions that the guard joins with 'and' are considered.
    """
    found: set[str] = set()
    pending = [guard]
    while pending:
        node, start = pending.pop(), False
        if type(node) is ir.Logic and node.op == "and":
            pending += (node.left, node.right)
        elif type(node) is ir.Unary and node.op == "not":
            node, start = node.operand, True
        if type(node) is ir.LocalRead and starts.get(node.name) is start:
            found.add(node.name)
    return found


def _unchanged_flags(
    asked: list[set[str]], init: stmt.Block, events: tuple[decl.Event, ...], starts: Starts
) -> set[str]:
    """Return the bool variables that keep their initial values because only events that wait for them change them.

    The result is the largest set in which each variable is changed only by events that wait for a variable in the set.
    """
    waiting: dict[str, list[int]] = {}
    for position, flags in enumerate(asked):
        for flag in flags:
            waiting.setdefault(flag, []).append(position)
    missing = [len(flags) for flags in asked]
    pending = [position for position, count in enumerate(missing) if not count]

    def turn(flags: set[str]) -> None:
        for flag in flags & waiting.keys():
            for position in waiting.pop(flag):
                missing[position] -= 1
                if not missing[position]:
                    pending.append(position)

    def run() -> None:
        while pending and waiting:
            turn(_changed_flags(events[pending.pop()].effect, starts))

    turn(_changed_flags(init, starts))
    run()
    if waiting:
        turn(waiting.keys() - set[str]().union(*(_changed_flags(event.effect, starts) for event in events)))
        run()
    return set(waiting)


def _changed_flags(block: stmt.Block, starts: Starts) -> set[str]:
    """Return the bool variables that a block may change from their initial values."""
    found: set[str] = set()
    for statement in statements(block):
        match statement:
            case stmt.Assign(stmt.LocalPlace(name), value):
                if name in starts and not (type(value) is ir.Const and value.value is starts[name]):
                    found.add(name)
            case _:
                pass
    return found
