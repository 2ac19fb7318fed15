"""Text -> syntax tree: runs the generated LALR(1) tables over the layout's tokens, one section at a time."""

from __future__ import annotations

import gc
from typing import Any

from koordgen._generated.grammar import END, RULES, START, STATES
from koordgen.diagnostics import Diagnostic, in_order
from koordgen.node import Node
from koordgen.source import Source
from koordgen.syntax import build, decl, expr
from koordgen.syntax.layout import Chunk, sections

DEEPEST_TREE = 100

# (symbol, length, function or None) by rule.
_RULES = tuple((symbol, length, getattr(build, action) if action else None) for symbol, length, action in RULES)


def parse(source: Source) -> tuple[decl.Program | None, list[Diagnostic]]:
    """The tree of a text, or None with what is wrong: at most one mistake for each section of it."""
    collecting = gc.isenabled()
    gc.disable()  # a tree has no cycles; collecting while it grows doubles the time of a long program
    try:
        chunks, found = sections(source)
        read = []
        for chunk in chunks:
            if chunk.sound:
                try:
                    read.append(_section(chunk))
                except build.Refused as refused:
                    found.append(refused.diagnostic)
    finally:
        if collecting:
            gc.enable()
    return (None if found else decl.Program(tuple(read))), in_order(found)


def _section(chunk: Chunk) -> Any:
    states = [START]
    values: list[Any] = []
    for position, token in enumerate(chunk.tokens):
        symbol = token[0]
        while True:
            action = STATES[states[-1]].get(symbol)
            if action is None:
                from koordgen.syntax.mistake import explain

                raise build.Refused(explain(chunk.tokens, position, states))
            if action >= 0:
                states.append(action)
                values.append(token)
                break
            name, length, make = _RULES[-action - 1]
            if make is not None:
                children = values[-length:]
                del states[-length:], values[-length:]
                values.append(make(_spliced(children)))
            elif length == 1 and name[0] != "_":  # passes its only child on
                del states[-1]
            else:
                children = values[-length:]
                del states[-length:], values[-length:]
                values.append(_spliced(children))
            state = STATES[states[-1]][name]
            states.append(state)
            if state == END and symbol == "$END":
                section = values[0]
                if chunk.long:
                    _measure(section)
                return section
    raise AssertionError("a section ends with $END")


def _spliced(children: list[Any]) -> list[Any]:
    """The lists that `_rules` made, dissolved; the first one is used further, so that long blocks stay linear."""
    for child in children:
        if type(child) is list:
            break
    else:
        return children
    result: list[Any] = children[0] if type(children[0]) is list else [children[0]]
    for child in children[1:]:
        if type(child) is list:
            result.extend(child)
        else:
            result.append(child)
    return result


def _measure(section: Node) -> None:
    """Refuses an expression whose depth would exhaust the passes that walk it recursively."""
    pending: list[tuple[Any, int]] = [(section, 0)]
    while pending:
        node, depth = pending.pop()
        if isinstance(node, tuple):
            pending.extend((child, depth) for child in node if isinstance(child, (Node, tuple)))
            continue
        if isinstance(node, expr.Expr):
            depth += len(node.rest) if isinstance(node, expr.Compare) else 1
        if depth > DEEPEST_TREE:
            message = f"this expression is nested more than {DEEPEST_TREE} deep"
            help = "give parts of it names of their own"
            raise build.Refused(Diagnostic("K007", "error", message, node.span, help=help))
        for field in type(node).__match_args__:
            child = getattr(node, field)
            if isinstance(child, (Node, tuple)) and field not in ("span", "type_span", "name_span"):
                pending.append((child, depth))
