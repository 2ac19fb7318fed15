"""What solvers answer: S-expressions, and the values in them."""

from __future__ import annotations

import re
from fractions import Fraction

Expression = str | list["Expression"]
# A model's value: exact, or a name of an element of an uninterpreted sort, or an irrational number as text.
ModelValue = bool | int | Fraction | str

_TOKEN = re.compile(r'\|[^|]*\||"(?:[^"]|"")*"|[()]|[^\s()|"]+')


class Unreadable(Exception):
    """What was answered is no S-expression, or not the one that was asked for."""


def read(text: str) -> list[Expression]:
    """All expressions of a text. Raises Unreadable."""
    stack: list[list[Expression]] = [[]]
    for token in _TOKEN.findall(text):
        if token == "(":
            stack.append([])
        elif token == ")":
            if len(stack) == 1:
                raise Unreadable("a bracket closes that was never opened")
            done = stack.pop()
            stack[-1].append(done)
        else:
            stack[-1].append(token)
    if len(stack) != 1:
        raise Unreadable("a bracket is never closed")
    return stack[0]


def values(text: str, count: int) -> list[ModelValue]:
    """The answer to `get-value` of `count` terms, in their order. Raises Unreadable."""
    match read(text):
        case [list(pairs)] if len(pairs) == count:
            if not all(isinstance(pair, list) and len(pair) == 2 for pair in pairs):
                raise _strange(pairs)
            return [value(pair[1]) for pair in pairs]
        case found:
            raise _strange(found)


def value(node: Expression) -> ModelValue:
    """One value. Raises Unreadable where a number is none that can be written down exactly as a fraction."""
    match node:
        case "true" | "false":
            return node == "true"
        case str(text) if text[0].isdigit():
            return Fraction(text) if "." in text else int(text)
        case str(text):
            return text
        case ["-", inner]:
            return -_number(inner)
        case ["/", over, under]:
            below = Fraction(_number(under))
            if not below:
                raise _strange(node)
            return Fraction(_number(over)) / below
        case ["to_real", inner]:
            return Fraction(_number(inner))
        case ["as", str(name), _]:
            return name
        case _:
            return f"irrational {shown(node)}"


def _number(node: Expression) -> int | Fraction:
    found = value(node)
    if isinstance(found, (bool, str)):
        raise Unreadable(f"{shown(node)} is no number")
    return found


def _strange(node: object) -> Unreadable:
    return Unreadable(f"a value was expected, not {shown(node)[:80]}")


def shown(node: object) -> str:
    return f"({' '.join(map(shown, node))})" if isinstance(node, list) else str(node)
