"""Layout of generated Python: expressions that record where lines may be broken, and the lines of a module.

s.local_where.value = cell(my_here, PARAM_SIZE)      if it fits into WIDTH columns

s.local_where.value = nearest_of_all(                if the parts between the brackets fit into one line
    my_here, my_others, PARAM_SIZE
)
s.local_where.value = (                              otherwise one line for each part
    first(my_others)
    + last(my_others)
)
"""

from __future__ import annotations

from collections.abc import Sequence

WIDTH = 100  # columns of a generated line; a part that cannot be broken may exceed it
STEP = "    "
# Largest depth of brackets that are broken over several lines. Each level may add a pair of brackets, and Python
# accepts at most 200 nested pairs.
_DEEPEST = 12


class _Code(str):
    """Text of an expression in one line, with its parts. Formatting yields a plain str, which is never broken."""

    __slots__ = ("parts",)
    parts: Sequence[str]


class _Brackets(_Code):
    """Bracketed expression: the text up to the opening bracket, the parts, and the closing bracket."""

    __slots__ = ("comma", "dense")
    comma: bool  # True: if the expression is broken, each part ends with a comma
    dense: bool  # True: if the expression is broken, each line has as many parts as fit


class _Chain(_Code):
    """Chain of operands, each with the operator before it. Between brackets, each may stand on a line of its own."""

    __slots__ = ()


class _Sequence(_Code):
    """Adjacent parts of code. A line may be broken inside a part, never between two parts."""

    __slots__ = ()


def brackets(opening: str, items: Sequence[str], closing: str, dense: bool = False) -> str:
    """Return `f(a, b)`, `(a, b)` or `[a, b]`.

    `opening`: the text up to and with the opening bracket. `dense`: if the expression is broken over several lines,
    each line has as many items as fit.
    """
    if not items:
        return f"{opening}{closing}"
    found = _Brackets(f"{opening}{', '.join(items)}{closing}")
    found.parts, found.comma, found.dense = (opening, *items, closing), len(items) > 1, dense
    return found


def display(items: Sequence[str]) -> str:
    """Return the code of a tuple of the given items."""
    if len(items) != 1:
        return brackets("(", items, ")", not any(isinstance(item, _Code) for item in items))
    found = _Brackets(f"({items[0]},)")
    found.parts, found.comma, found.dense = ("(", *items, ")"), True, False
    return found


def chain(*parts: str) -> str:
    """Return the code of the given operands with spaces between them."""
    found = _Chain(" ".join(parts))
    found.parts = parts
    return found


def longer(first: str, last: str) -> str:
    """Return `first` with the operator and the operand in `last` appended.

    If `first` is a chain, its operators must have the same precedence as the operator in `last`.
    """
    return chain(*first.parts, last) if isinstance(first, _Chain) else chain(first, last)


def alternatives(parts: Sequence[str], otherwise: str, more: bool) -> str:
    """Return `a if b else c` from the parts `a` and `if b` and `otherwise`, the expression `c`.

    `more`: True if `otherwise` is itself a conditional expression.
    """
    if more and isinstance(otherwise, _Chain):
        return chain(*parts, joined("else ", otherwise.parts[0]), *otherwise.parts[1:])
    return chain(*parts, joined("else ", otherwise))


def joined(*parts: str) -> str:
    """Return code that consists of the given parts without spaces between them."""
    text = "".join(parts)
    if not any(isinstance(part, _Code) for part in parts):
        return text
    found = _Sequence(text)
    found.parts = [p for part in parts for p in (part.parts if isinstance(part, _Sequence) else (part,))]
    return found


class Page:
    """Lines of a module, or of a part of one, each with its line number in the Koord program, or 0."""

    def __init__(self) -> None:
        self.lines: list[tuple[str, int]] = []

    def add(self, code: str = "", indent: str = "", line: int = 0) -> None:
        """Add code, broken into as many lines as needed. A comment in the first of these lines names `line`."""
        mark = f"  # line {line}" if line else ""
        if len(indent) + len(code) + len(mark) <= WIDTH:
            self.lines.append((f"{indent}{code}{mark}" if code else "", line))
            return
        broken = [indent]
        _put(broken, code, len(indent), len(mark), False)
        broken[0] += mark
        self.lines += [(text, line) for text in broken]

    def gap(self, count: int = 2) -> None:
        """Add empty lines."""
        self.lines += [("", 0)] * count


def _put(lines: list[str], code: str, indent: int, tail: int, bare: bool) -> None:
    """Append code to the last line, and break the code over several lines if necessary.

    `tail`: columns to keep free at the end of the code, for the text that follows. `bare`: True if the code stands
    alone between brackets and the last line is still empty.
    """
    if not isinstance(code, _Code) or len(lines[-1]) + len(code) + tail <= WIDTH:
        lines[-1] += code
    elif isinstance(code, _Brackets):
        _put_brackets(lines, code, indent)
    elif isinstance(code, _Sequence):
        for place, part in enumerate(code.parts):
            _put(lines, part, indent, _needed(code.parts[place + 1 :], tail), False)
    elif bare:
        for place, part in enumerate(code.parts):
            if place:
                lines.append(" " * indent)
            _put(lines, part, indent, tail if place == len(code.parts) - 1 else 0, False)
    else:
        _put_brackets(lines, brackets("(", (code,), ")"), indent)


def _put_brackets(lines: list[str], code: str, indent: int) -> None:
    assert isinstance(code, _Brackets)
    statement = len(lines[0]) - len(lines[0].lstrip())
    if indent - statement >= _DEEPEST * len(STEP):
        lines[-1] += code
        return
    opening, *items, closing = code.parts
    lines[-1] += opening
    deeper = indent + len(STEP)
    lines.append(" " * deeper)
    within = code[len(opening) : len(code) - len(closing)]
    if deeper + len(within) <= WIDTH:
        lines[-1] += within
    elif code.dense:
        for item in items:
            if len(lines[-1]) + len(item) + len(" ,") > WIDTH and lines[-1].strip():
                lines.append(" " * deeper)
            lines[-1] += f"{' ' * bool(lines[-1].strip())}{item},"
    else:
        for place, item in enumerate(items):
            if place:
                lines.append(" " * deeper)
            _put(lines, item, deeper, code.comma, True)
            lines[-1] += "," * code.comma
    lines.append(" " * indent + closing)


def _needed(parts: Sequence[str], tail: int) -> int:
    """Return the number of columns of the parts and `tail`, counted up to the first bracket that may be broken."""
    columns = 0
    for part in parts:
        if isinstance(part, _Code):
            return columns + len(part.parts[0] if isinstance(part, _Brackets) else "(")
        columns += len(part)
    return columns + tail


def line_map(head: Page, body: Page, path: str) -> Page:
    """Return the table from lines of the module to lines of the program. Error messages at run time use it.

    The module begins with `head` and `body`.
    """
    page = Page()
    page.add(f"# Line of this file: line of {path}.")
    numbered = enumerate([*head.lines, *body.lines], 1)
    pairs = [f"{number}: {line}" for number, (_, line) in numbered if line]
    page.add(brackets("LINES: dict[int, int] = {", pairs, "}", dense=True))
    return page


def text(*pages: Page) -> str:
    """Return the text of the pages, concatenated."""
    return "".join([f"{line}\n" for page in pages for line, _ in page.lines])
