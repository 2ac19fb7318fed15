"""LR driver: runs the generated LALR(1) tables over the tokens of one section.

The driver does not walk the tables: it walks what they come to, worked out when first needed and kept. A chain of
rules that only pass a value on (`NAME` is an atom, is a postfix, ... is an expression: twelve rules) is one step.
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


class Stuck(Exception):
    """No rule goes on at `tokens[position]`."""

    def __init__(self, position: int) -> None:
        super().__init__(position)
        self.position = position


def planned(state: int, symbol: str) -> int | None:
    """What the tables say; None where nothing goes on."""
    return STATES[state].get(symbol) if symbol != "BROKEN" else BROKEN.get(state)


class _Row(dict[str, Any]):
    """What a state does at a symbol: an int to shift to that state, a tuple `(top, make, after)` to reduce the slice
    `top` of the stack, None for its last value only; None where it is stuck or has come to the end."""

    __slots__ = ("state",)

    def __init__(self, state: int) -> None:
        self.state = state

    def __missing__(self, symbol: str) -> Any:
        code = planned(self.state, symbol)
        action = code if code is None or code >= 0 else _reduction(-code - 1, symbol)
        self[symbol] = action
        return action


class _After(dict[int, Any]):
    """By the state below what was reduced to `made`: the state and the action at which the next symbol `ahead` finds
    the parser, when all rules that only pass the value on are through."""

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
    """The lists that `_rules` made, dissolved; the first one is used further, so that long blocks stay linear."""
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
    """The node of a section, from its tokens. Raises Stuck, and Refused for what only the builders see."""
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
                raise Stuck(position)
            return values[0]
        state = action
        states.append(state)
        values.append(token)
    raise AssertionError("a section ends with $END")


def section(tokens: Sequence[Any], long: bool) -> Any:
    """The node of a section. Raises Stuck and Refused."""
    node = run(tokens)
    if long:
        measure(node)
    return node


def measure(section: Node) -> None:
    """Refuses what is nested so deeply that it would exhaust the passes that walk it recursively: expressions and
    types, and blocks on one line (`while a: while b: ...`)."""
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
            raise build.refused("K007", f"blocks are nested more than {DEEPEST_BLOCKS} deep", node.span)
        if depth > DEEPEST_TREE:
            raise too_deep(node.span)
        for field in type(node).__match_args__:
            child = getattr(node, field)
            if isinstance(child, (Node, tuple)) and type(child) is not Span:
                pending.append((child, blocks, depth))


def too_deep(span: Span) -> build.Refused:
    """To be raised: the expression there is nested too deeply."""
    message = f"this expression is nested more than {DEEPEST_TREE} deep"
    return build.refused("K007", message, span, "give parts of it names of their own")
