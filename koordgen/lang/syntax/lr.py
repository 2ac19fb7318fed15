"""LR driver: runs the generated LALR(1) tables over the tokens of one section.

The driver does not use the tables directly, but actions that are derived from them on demand and cached. A chain of
rules that only pass a value on (`NAME` is an atom, is a postfix, ... is an expression: twelve rules) is one action.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from koordgen.lang.node import Node
from koordgen.lang.source import Span
from koordgen.lang.syntax import build, expr, stmt, types
from koordgen.lang.syntax._generated.grammar import BROKEN, END, RULES, SPLICING, START, STATES
from koordgen.lang.syntax.layout import DEEPEST_BLOCKS

DEEPEST_TREE = 100


class UnexpectedToken(Exception):
    """A syntax error: the parser cannot continue at `tokens[position]`."""

    def __init__(self, position: int) -> None:
        super().__init__(position)
        self.position = position


def table_entry(state: int, symbol: str) -> int | None:
    """Return the entry of the tables for a state and a symbol; None if there is none."""
    return STATES[state].get(symbol) if symbol != "BROKEN" else BROKEN.get(state)


class _Row(dict[str, Any]):
    """Cached actions of a state, by symbol.

    An int: shift to that state. A tuple `(top, make, after)`: reduce the slice `top` of the stack; if `top` is None,
    only the last value. None: a syntax error, or the end.
    """

    __slots__ = ("state",)

    def __init__(self, state: int) -> None:
        self.state = state

    def __missing__(self, symbol: str) -> Any:
        code = table_entry(self.state, symbol)
        action = code if code is None or code >= 0 else _reduction(-code - 1, symbol)
        self[symbol] = action
        return action


class _After(dict[int, Any]):
    """Cache: state below `made` on the stack -> the next state, and its action for the symbol `ahead`.

    Rules that only pass a value on are already applied.
    """

    __slots__ = ("ahead", "made")

    def __init__(self, made: str, ahead: str) -> None:
        self.made = made
        self.ahead = ahead

    def __missing__(self, below: int) -> Any:
        state = STATES[below][self.made]
        while (action := ROWS[state][self.ahead]).__class__ is tuple and action[1] is None:
            state = STATES[below][action[2].made]
        self[below] = state, action
        return state, action


ROWS = [_Row(state) for state in range(len(STATES))]
_AFTER: dict[tuple[str, str], _After] = {}


def _reduction(rule: int, ahead: str) -> tuple[slice | None, Any, _After]:
    made, length, action = RULES[rule]
    top = slice(-length, None) if length > 1 else None
    after = _AFTER.get((made, ahead))
    if after is None:
        after = _AFTER[made, ahead] = _After(made, ahead)
    make: Callable[[list[Any]], Any] | None = getattr(build, action) if action else None
    if make is None:
        return top, (None if length == 1 else _spliced), after
    return top, (_splicing(make) if rule in SPLICING else make), after


def _splicing(make: Callable[[list[Any]], Any]) -> Callable[[list[Any]], Any]:
    return lambda children: make(_spliced(children))


def _spliced(children: list[Any]) -> list[Any]:
    """Splice the lists that `_rules` made into one.

    Extends the first one in place, so long blocks take linear time.
    """
    result: list[Any] = []
    for child in children:
        if child.__class__ is not list:
            result.append(child)
        elif result:
            result += child
        else:
            result = child
    return result


def run(tokens: Sequence[Any]) -> Any:
    """Parse the tokens of a section to a node. Raises Stuck, and Refused for errors that builders find."""
    rows = ROWS
    state = START
    states = [state]
    values: list[Any] = []
    for position, token in enumerate(tokens):
        action = rows[state][token[0]]
        while action.__class__ is tuple:
            top, make, after = action
            if top is None:
                if make is not None:
                    values[-1] = make([values[-1]])
                state, action = after[states[-2]]
                states[-1] = state
            else:
                children = values[top]
                del values[top], states[top]
                values.append(make(children))
                state, action = after[states[-1]]
                states.append(state)
        if action is None:
            if state != END:
                raise UnexpectedToken(position)
            return values[0]
        state = action
        states.append(state)
        values.append(token)
    raise AssertionError("a section ends with $END")


def section(tokens: Sequence[Any], long: bool) -> Any:
    """Parse a section to a node, with a check of its depth if `long`. Raises Stuck and Refused."""
    node = run(tokens)
    if long:
        check_depth(node)
    return node


def check_depth(section: Node) -> None:
    """Raise Refused if a tree is nested too deeply for the recursive passes.

    Counts expressions, types, and blocks on one line (`while a: while b: ...`).
    """
    pending: list[tuple[Any, int, int]] = [(section, 0, 0)]
    while pending:
        node, blocks, depth = pending.pop()
        if isinstance(node, tuple):
            pending.extend((child, blocks, depth) for child in node if isinstance(child, (Node, tuple)))
            continue
        if isinstance(node, (expr.Expr, types.TypeExpr)):
            depth += len(node.rest) if isinstance(node, expr.Compare) else 1
        elif isinstance(node, (stmt.If, stmt.For, stmt.CountedFor, stmt.While, stmt.Atomic)):
            blocks += 1
        if blocks > DEEPEST_BLOCKS:
            raise build.builder_error("K007", f"blocks are nested more than {DEEPEST_BLOCKS} deep", node.span)
        if depth > DEEPEST_TREE:
            raise too_deep(node.span)
        for field in type(node).__match_args__:
            child = getattr(node, field)
            if isinstance(child, (Node, tuple)) and type(child) is not Span:
                pending.append((child, blocks, depth))


def too_deep(span: Span) -> build.BuilderError:
    """Make an exception to raise for an expression that is nested too deeply."""
    message = f"this expression is nested more than {DEEPEST_TREE} deep"
    return build.builder_error("K007", message, span, "assign parts of it to variables")
