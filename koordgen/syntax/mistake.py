"""Says what is wrong where the parser cannot go on, in the words of the language."""

from __future__ import annotations

from koordgen._generated.grammar import RULES, STATES
from koordgen.diagnostics import Diagnostic
from koordgen.source import Span
from koordgen.syntax.layout import KEYWORDS, Token
LATER = frozenset()

# Types of the full language; `Point` and the numbers are there already.
LATER_TYPES = frozenset(
    ("string", "List", "Map", "Set", "Queue", "Pose", "GridMap", "Grid", "Scan", "PathPlanner", "stream")
)

_MODERN = {"&&": "and", "||": "or", "!": "not"}
_LATER_MARKS = {"[": "a list", "{": "a set", "**": "a power", "->": "a function's type", "STRING": "a string"}
_NO_MARKS = {
    ";": "write each statement on a line of its own",
    "&": "write 'and'",
    "|": "write 'or'",
    "~": "write 'not'",
    "?": "write 'a if condition else b'",
}
_EXPRESSION = {"NAME", "INT", "FLOAT", "True", "False", "(", "-"}
_OPERATORS = {"+", "-", "*", "/", "//", "%", "==", "!=", "<", "<=", ">", ">=", "and", "or", "if", ".", "[", "("}
_MADE = {name for name, _, _ in RULES}  # symbols that are no tokens
_WORDS = {
    "NAME": "a name",
    "NEWLINE": "the end of the line",
    "INDENT": "an indented line",
    "DEDENT": "the end of the block",
    "$END": "the end of the section",
    "INT": "a number",
    "FLOAT": "a number",
}


def explain(tokens: list[Token], position: int, states: list[int]) -> Diagnostic:
    """The diagnostic for `tokens[position]`, at which the parser with this stack of states cannot go on."""
    kind, text, line, column = token = tokens[position]
    before = tokens[position - 1] if position else None
    span = Span(line, column, line, column + max(1, len(text)))
    expected = _acceptable(states)
    later = _later(tokens, position)
    if later is not None:
        return later
    if kind == "BAD":
        shown = text if text.isprintable() else f"U+{ord(text):04X}"
        return Diagnostic("K002", "error", f"unexpected character '{shown}'", span, help=_NO_MARKS.get(text, ""))
    if kind in _MODERN:
        message = f"'{text}' is not supported by this version yet"
        return Diagnostic("K003", "error", message, span, help=f"write '{_MODERN[text]}'")
    if kind == "INDENT":
        help = "only what belongs to a block stands deeper than the line before"
        return Diagnostic("K008", "error", "unexpected indentation", span, help=help)
    if expected == {"INDENT"} and position > 1:
        colon = tokens[position - 2]
        message = f"expected an indented block {_after(tokens, position - 2)}"
        return Diagnostic("K008", "error", message, _behind(colon))
    if kind == "=" and expected & {"==", ")"} and "=" not in expected:
        if _first_of_line(tokens, position) in ("pre", "if", "elif"):
            return Diagnostic(
                "K001", "error", "'=' assigns and cannot stand in a condition", span, help="'==' compares"
            )
        return Diagnostic("K001", "error", "what stands before '=' cannot be assigned", span)
    if ":" in expected:
        place = _behind(before) if before is not None else span
        help = _missing_colon(tokens, position)
        return Diagnostic("K001", "error", f"expected ':' {_after(tokens, position)}", place, help=help)
    if kind in KEYWORDS and expected == {"NAME"}:
        help = f"'{text}' is a word of the language; choose another name"
        return Diagnostic("K001", "error", f"expected a name, found '{text}'", span, help=help)
    if kind in ("NEWLINE", "DEDENT", "$END") and before is not None and before[0] not in ("NEWLINE", "DEDENT"):
        span = _behind(before)
    message = f"expected {_list(expected)}, found {_found(token)}"
    if before is not None and before[1] and (len(expected) <= 3 or expected >= _EXPRESSION):
        message = f"expected {_list(expected)} after '{before[1]}', found {_found(token)}"
    return Diagnostic("K001", "error", message, span, help=_habit(tokens, position, expected))


def _missing_colon(tokens: list[Token], position: int) -> str:
    """What may have been meant where a header is expected: `else if`, or a variable outside of any section."""
    if position and tokens[position - 1][0] == "else" and tokens[position][0] == "if":
        return "write 'elif'"
    start = _line_start(tokens, position)
    rest = [token[0] for token in tokens[start : position + 2]]
    if rest[:2] == ["NAME", "="] or rest[:3] == ["NAME", "NAME", "="]:
        return "a variable is declared under 'local:', 'allread:' or 'allwrite:'"
    return ""


def _habit(tokens: list[Token], position: int, expected: set[str]) -> str:
    """How Koord has what one writes otherwise in Python."""
    kind, text, _, _ = tokens[position]
    if kind == "," and ")" in expected:
        return "a point is written Point(x, y, z)"
    if text == "is" and "==" in expected:
        return "'==' compares"
    before = tokens[position - 1] if position else None
    if expected == {"NAME"} and kind in ("=", "NEWLINE") and before is not None and before[0] == "NAME":
        return f"a type stands before the name: int {before[1]}"
    return ""


def _later(tokens: list[Token], position: int) -> Diagnostic | None:
    """A construct of the full language that this version lacks."""
    kind, text, _, _ = tokens[position]
    if kind in LATER:
        return _unsupported(f"'{text}'", tokens[position])
    for place in range(_line_start(tokens, position), position + 1):
        word = tokens[place]
        if word[1] in LATER_TYPES and (place == position or tokens[place + 1][0] in ("<", "NAME")):
            return _unsupported(f"the type {word[1]}", word)
    if kind in _LATER_MARKS:
        return _unsupported(_LATER_MARKS[kind], tokens[position])
    if kind == "'" and position and tokens[position - 1][0] != "NAME":  # behind a name it is a prime
        return _unsupported("a string", tokens[position])
    return None


def _line_start(tokens: list[Token], position: int) -> int:
    """Where in `tokens` the logical line begins."""
    while position and tokens[position - 1][0] not in ("NEWLINE", "INDENT", "DEDENT"):
        position -= 1
    return position


def _first_of_line(tokens: list[Token], position: int) -> str:
    return tokens[_line_start(tokens, position)][0]


def _unsupported(what: str, token: Token) -> Diagnostic:
    _, text, line, column = token
    span = Span(line, column, line, column + len(text))
    return Diagnostic("K003", "error", f"{what} is not supported by this version yet", span)


def _acceptable(states: list[int]) -> set[str]:
    """The tokens with which the parser could go on; a table's row alone also names some that fail later."""
    return {symbol for symbol in STATES[states[-1]] if symbol not in _MADE and _accepts(states, symbol)}


def _accepts(states: list[int], symbol: str) -> bool:
    stack = list(states)
    while True:
        action = STATES[stack[-1]].get(symbol)
        if action is None:
            return False
        if action >= 0:
            return True
        name, length, _ = RULES[-action - 1]
        del stack[len(stack) - length :]
        stack.append(STATES[stack[-1]][name])


def _after(tokens: list[Token], position: int) -> str:
    """`after 'pre'`, `after 'using Motion'`: the header before a token, at most its first words."""
    first = position
    while first and tokens[first - 1][0] not in ("NEWLINE", "INDENT", "DEDENT", ":"):
        first -= 1
    words = [t[1] for t in tokens[first:position] if t[1]]
    if not words:
        return f"after '{tokens[position - 1][1]}'" if position and tokens[position - 1][1] else "here"
    if words[0] in ("if", "elif") and len(words) > 2:
        return f"after the condition of '{words[0]}'"
    return f"after '{' '.join(words[:2])}'"


def _behind(token: Token) -> Span:
    _, text, line, column = token
    return Span(line, column + len(text), line, column + len(text) + 1)


def _found(token: Token) -> str:
    return _WORDS.get(token[0], f"'{token[1]}'") if not token[1] else f"'{token[1]}'"


def _list(expected: set[str]) -> str:
    groups = []
    if expected >= _EXPRESSION:
        groups.append("a statement" if "pass" in expected else "an expression")
        expected = expected - _EXPRESSION - {"not", "pass", "stop", "if"}
    if len(expected & _OPERATORS) > 3:
        groups.append("an operator")
        expected = expected - _OPERATORS
    groups += [_WORDS.get(symbol, f"'{symbol}'") for symbol in sorted(expected)]
    groups = list(dict.fromkeys(groups))
    if len(groups) > 4:
        groups = [*groups[:4], "..."]
    return groups[0] if len(groups) == 1 else f"{', '.join(groups[:-1])} or {groups[-1]}"
