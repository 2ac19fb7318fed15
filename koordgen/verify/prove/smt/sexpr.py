"""S-expressions: parser for answers of solvers, and for the values in the answers."""

from __future__ import annotations

import re
from fractions import Fraction

Expression = str | list["Expression"]
# Value in a model: a truth value, an int or a fraction; the name of an element of an uninterpreted sort; or the text of
# an irrational number.
ModelValue = bool | int | Fraction | str

_TOKEN = re.compile(r'\|[^|]*\||"(?:[^"]|"")*"|[()]|[^\s()|"]+')


class Unreadable(Exception):
    """Raised if a text is not an S-expression, or is not an answer to the command that was sent."""


def read(text: str) -> list[Expression]:
    """Return all expressions of a text. Raises Unreadable."""
    stack: list[list[Expression]] = [[]]
    for token in _TOKEN.findall(text):
        if token == "(":
            stack.append([])
        elif token == ")":
            if len(stack) == 1:
                raise Unreadable("a closing bracket has no opening bracket")
            done = stack.pop()
            stack[-1].append(done)
        else:
            stack[-1].append(token)
    if len(stack) != 1:
        raise Unreadable("a bracket is never closed")
    return stack[0]


def values(text: str, count: int) -> list[ModelValue]:
    """Return the values in an answer to `get-value` of `count` terms, in their order. Raises Unreadable."""
    match read(text):
        case [list(pairs)] if len(pairs) == count:
            if not all(isinstance(pair, list) and len(pair) == 2 for pair in pairs):
                raise _strange(pairs)
            return [value(pair[1]) for pair in pairs]
        case found:
            raise _strange(found)


def value(node: Expression) -> ModelValue:
    """Return one value. Raises Unreadable if an operand of `-`, `/` or `to_real` is not an exact number."""
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
            return f"irrational {to_text(node)}"


def _number(node: Expression) -> int | Fraction:
    found = value(node)
    if isinstance(found, (bool, str)):
        raise Unreadable(f"expected a number, found {to_text(node)}")
    return found


def _strange(node: object) -> Unreadable:
    return Unreadable(f"expected a value, found {to_text(node)[:80]}")


def to_text(node: object) -> str:
    return f"({' '.join(map(to_text, node))})" if isinstance(node, list) else str(node)
