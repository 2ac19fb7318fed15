"""Diagnostics of syntax errors."""

from __future__ import annotations

from koordgen.lang.diagnostics import Diagnostic
from koordgen.lang.syntax._generated.grammar import RULES, STATES
from koordgen.lang.syntax.habits import HABITS, headers
from koordgen.lang.syntax.layout import KEYWORDS, Token
from koordgen.lang.syntax.marks import MARKS
from koordgen.lang.syntax.spelling import misspelt
from koordgen.lang.syntax.spot import Spot, behind, place, shown, start_of_line

_EXPRESSION = {"NAME", "INT", "FLOAT", "STRING", "True", "False", "(", "[", "{", "-", "not", "forall", "exists"}
_STATEMENT = {
    "GENERIC", "if", "for", "while", "atomic", "return", "break", "continue", "pass", "stop", "invariant",
}  # fmt: skip
_SECTION = {
    "using", "param", "allread", "allwrite", "local", "def", "fun", "extern", "spec", "axiom", "invariant", "initially",
    "init", "priority", "NAME",
}  # fmt: skip
_OPERATORS = {
    "+", "-", "*", "/", "//", "%", "**", "<<", "==", "!=", "<", "<=", ">", ">=", "and", "or", "not", "in", "if", ".",
    "[", "(", "'",
}  # fmt: skip
_AUGMENTED = {"+=", "-=", "*=", "/=", "//=", "%=", "**="}
_UNSAID = {"!", "&&", "||"}  # the 2020 dialect: accepted, but not suggested
_CONDITIONS = {
    "pre", "if", "elif", "while", "assume", "requires", "ensures", "invariant", "initially", "axiom", "return",
}  # fmt: skip
_MADE = {name for name, _, _ in RULES}  # nonterminal symbols
_WORDS = {
    "NAME": "a name",
    "GENERIC": "a type",
    "NEWLINE": "the end of the line",
    "INDENT": "an indented line",
    "DEDENT": "the end of the block",
    "$END": "the end of the section",
    "INT": "a number",
    "FLOAT": "a number",
    "STRING": "a string",
}


def explain(tokens: list[Token], position: int, states: list[int]) -> Diagnostic:
    """Return the diagnostic for `tokens[position]`, at which the parser cannot continue.

    `states` is the parser's stack after the previous token, before any reduction for the rejected one. An LALR parser
    may reduce before it finds that a token does not fit; then the tokens that would have fitted are no longer known.
    """
    spot = Spot(tokens, position, _acceptable(states))
    for rule in (*MARKS, *HABITS, _indentation, _equals, misspelt, headers, _colon, _taken, _one_formula):
        told = rule(spot)
        if told is not None:
            return told
    return _expected(spot)


def _indentation(spot: Spot) -> Diagnostic | None:
    if spot.kind == "INDENT":
        before = spot.tokens[start_of_line(spot.tokens, spot.position - 1)]
        depth = f"indent it by {before[3] - 1} spaces as line {before[2]}"
        help = f"{depth}: only what belongs to a block stands deeper than the line before"
        return spot.error("unexpected indentation", help, code="K008")
    if spot.expected == {"INDENT"} and spot.position > 1:
        colon = spot.tokens[spot.position - 2]
        message = f"expected an indented block {_after(spot.tokens, spot.position - 2)}"
        return spot.error(message, span=behind(colon), code="K008")
    return None


def _equals(spot: Spot) -> Diagnostic | None:
    """Report `=` in a place where nothing can be assigned."""
    if spot.kind != "=" or "==" not in spot.expected:
        return None
    if any(token[0] == "=" or token[0] in _AUGMENTED for token in spot.head) and not spot.bracket:
        help = "write one assignment a line"
        return spot.error("an assignment has no value and cannot stand in another one", help)
    if spot.bracket or _governing(spot) in _CONDITIONS:
        return spot.error("'=' assigns and cannot stand in a condition", "'==' compares")
    return spot.error("what stands before '=' cannot be assigned", span=place(spot.head[0], spot.head[-1]))


def _governing(spot: Spot) -> str:
    """Return the keyword that determines the kind of a line.

    It is the line's first word, or that of the header above its block.
    """
    tokens, start = spot.tokens, spot.start
    for token in reversed(spot.head):  # `E: pre: a = 3` begins with the event's name
        if token[0] in _CONDITIONS:
            return token[0]
    if start > 2 and [token[0] for token in tokens[start - 3 : start]] == [":", "NEWLINE", "INDENT"]:
        above = Spot(tokens, start - 3, set())
        return above.first[0]
    return spot.first[0]


def _colon(spot: Spot) -> Diagnostic | None:
    """Report a header without a colon."""
    if ":" not in spot.expected or spot.bracket:
        return None
    if spot.expected != {":"} and any(token[0] == ":" for token in spot.rest):
        return None  # the colon exists, so the error is something before it
    span = behind(spot.before) if spot.before is not None else spot.span
    help = ""
    header = spot.tokens[-1] if spot.ends else (spot.rest or [spot.first])[-1]
    deeper = any(token[0] == "INDENT" for token in spot.tokens[: spot.position + 2])
    if spot.start == 0 and spot.first[0] == "NAME" and header[0] != ":" and not deeper:
        help = _outside(spot)
    return spot.error(f"expected ':' {_after(spot.tokens, spot.position)}", help, span)


def _outside(spot: Spot) -> str:
    """Return a help for a line at the left margin that is not a header."""
    kinds = [token[0] for token in spot.tokens[: spot.position + 2]]
    if kinds[:2] == ["NAME", "="] or kinds[:2] == ["NAME", "NAME"]:
        return "a variable is declared under 'local:', 'allread:' or 'allwrite:'"
    return "a statement stands under 'init:' or an event's 'eff:'"


def _taken(spot: Spot) -> Diagnostic | None:
    """Report a reserved word in place of a name."""
    word = spot.kind in KEYWORDS or spot.kind == "GENERIC" or (spot.kind == spot.text and spot.text.isalpha())
    if not word:
        return None
    named = spot.expected == {"NAME"} or (
        "NAME" in spot.expected and (spot.next in ("=", "NEWLINE", "[", ")") or spot.next in _AUGMENTED)
    )
    if named and not (spot.kind == "GENERIC" and spot.next == "["):
        help = f"'{spot.text}' is a word of the language; choose another name"
        return spot.error(f"expected a name, found '{spot.text}'", help)
    return None


def _one_formula(spot: Spot) -> Diagnostic | None:
    """Report a second expression under `pre:` or under the header of a property."""
    if spot.expected == {"DEDENT"}:
        return spot.error("a condition is one expression", "join conditions with 'and' or 'or'")
    return None


def _expected(spot: Spot) -> Diagnostic:
    found = f"found '{shown(spot.text)}'" if spot.text else f"found {_WORDS.get(spot.kind, spot.kind)}"
    after = f" after '{shown(spot.before[1])}'" if spot.before is not None and spot.before[1] else ""
    help = ""
    if spot.ends and spot.wants_expression and spot.before_is(*_OPERATORS, "=", "||", "&&", *_AUGMENTED):
        help = "a line goes on after '\\', inside brackets, or where the next one begins with 'and' or 'or'"
    return spot.error(f"expected {_list(spot.expected)}{after}, {found}", help)


def _acceptable(states: list[int]) -> set[str]:
    """Return the tokens that the parser accepts next.

    A row of the table alone includes some that fail later.
    """
    return {symbol for symbol in STATES[states[-1]] if symbol not in _MADE and _accepts(states, symbol)}


def _accepts(states: list[int], symbol: str) -> bool:
    top: list[int] = []
    kept = len(states)  # the stack is `states[:kept] + top`; it may be too long to copy
    while True:
        action = STATES[top[-1] if top else states[kept - 1]].get(symbol)
        if action is None:
            return False
        if action >= 0:
            return True
        name, length, _ = RULES[-action - 1]
        of_top = min(length, len(top))
        del top[len(top) - of_top :]
        kept -= length - of_top
        top.append(STATES[top[-1] if top else states[kept - 1]][name])


def _after(tokens: list[Token], position: int) -> str:
    """Return a phrase for the header before a token: `after 'pre'`, `after 'using Motion'`."""
    first = position
    while first and tokens[first - 1][0] not in ("NEWLINE", "INDENT", "DEDENT", ":"):
        first -= 1
        if tokens[first][0] in ("forall", "exists"):
            return f"after the values of '{tokens[first][0]}'"
    words = [t[1] for t in tokens[first:position] if t[1]]
    if not words:
        return f"after '{tokens[position - 1][1]}'" if position and tokens[position - 1][1] else "here"
    if words[0] in ("if", "elif", "while") and len(words) > 1:
        return f"after the condition of '{words[0]}'"
    if words[0] == "for" and len(words) > 2:
        return "after the values of 'for'"
    if words[0] in ("fun", "extern") and len(words) > 2:
        return "after the type of the result"
    return f"after '{shown(' '.join(words[:2]))}'"


def _list(expected: set[str]) -> str:
    """Return the accepted tokens as text: first phrases for the constructs that they begin, then marks.

    At most four.
    """
    expected = expected - _UNSAID
    groups = []
    if "using" in expected:
        groups.append("a section")
        expected = expected - _SECTION
    if "pass" in expected:
        groups.append("a statement")
        expected = expected - _EXPRESSION - _STATEMENT
    if {"NAME", "INT", "("} <= expected:
        groups.append("an expression")
        expected = expected - _EXPRESSION - {"GENERIC"}
    if {"NAME", "GENERIC"} <= expected:
        groups.append("a type")
        expected = expected - {"NAME", "GENERIC", "("}
    if {"+", "=="} <= expected:
        groups.append("an operator")
        expected = expected - _OPERATORS
        expected = expected - _AUGMENTED if "=" in expected else expected
        expected = expected - {"NAME"}
    if len(expected) > 1:
        expected = expected - {"[", "max"}  # optional parts are rarely what is missing
    if "in" in expected:
        expected = expected - {"="}  # only in the 2020 dialect
    groups += [_WORDS.get(symbol, f"'{symbol}'") for symbol in sorted(expected, key=lambda s: (s in _WORDS, s))]
    groups = list(dict.fromkeys(groups))
    if len(groups) > 4:
        groups = [*groups[:4], "..."]
    return groups[0] if len(groups) == 1 else f"{', '.join(groups[:-1])} or {groups[-1]}"
