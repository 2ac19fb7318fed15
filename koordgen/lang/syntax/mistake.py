"""Diagnostics of syntax errors."""

from __future__ import annotations

from koordgen.lang.diagnostics import Diagnostic
from koordgen.lang.syntax._generated.grammar import RULES, STATES
from koordgen.lang.syntax.error_site import ErrorSite, column_after, place, shown, start_of_line
from koordgen.lang.syntax.habits import HABITS, headers
from koordgen.lang.syntax.layout import KEYWORDS, Token
from koordgen.lang.syntax.marks import MARKS
from koordgen.lang.syntax.spelling import misspelt_keyword

_EXPRESSION = {"NAME", "INT", "FLOAT", "STRING", "True", "False", "(", "[", "{", "-", "not", "forall", "exists"}
_STATEMENT = {
    "GENERIC", "if", "for", "while", "atomic", "return", "break", "continue", "pass", "stop", "invariant",
}  # fmt: skip
_SECTION = {
    "using", "param", "allread", "allwrite", "local", "def", "fun", "extern", "spec", "axiom", "invariant", "initially",
    "init", "priority", "export", "import", "provides", "NAME",
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
    site = ErrorSite(tokens, position, _acceptable(states))
    for rule in (
        *MARKS,
        *HABITS,
        _indentation,
        _equals,
        misspelt_keyword,
        headers,
        _colon,
        _reserved_word,
        _one_formula,
    ):
        diagnostic = rule(site)
        if diagnostic is not None:
            return diagnostic
    return _expected(site)


def _indentation(site: ErrorSite) -> Diagnostic | None:
    if site.kind == "INDENT":
        before = site.tokens[start_of_line(site.tokens, site.position - 1)]
        depth = f"indent it by {before[3] - 1} spaces as line {before[2]}"
        help = f"{depth}: only the lines of a block are indented deeper than the line before"
        return site.error("unexpected indentation", help, code="K008")
    if site.expected == {"INDENT"} and site.position > 1:
        colon = site.tokens[site.position - 2]
        message = f"expected an indented block {_after(site.tokens, site.position - 2)}"
        return site.error(message, span=column_after(colon), code="K008")
    return None


def _equals(site: ErrorSite) -> Diagnostic | None:
    """Report `=` in a place where nothing can be assigned."""
    if site.kind != "=" or "==" not in site.expected:
        return None
    if any(token[0] == "=" or token[0] in _AUGMENTED for token in site.head) and not site.bracket:
        help = "write each assignment on its own line"
        return site.error("an assignment has no value and cannot be part of another one", help)
    if site.bracket or _line_keyword(site) in _CONDITIONS:
        return site.error("'=' assigns and cannot be used in a condition", "'==' compares")
    return site.error("the left side of '=' cannot be assigned", span=place(site.head[0], site.head[-1]))


def _line_keyword(site: ErrorSite) -> str:
    """Return the keyword that determines the kind of a line.

    It is the line's first word, or that of the header above its block.
    """
    tokens, start = site.tokens, site.start
    for token in reversed(site.head):  # in `E: pre: a = 3` the first word is the event's name: the last keyword counts
        if token[0] in _CONDITIONS:
            return token[0]
    if start > 2 and [token[0] for token in tokens[start - 3 : start]] == [":", "NEWLINE", "INDENT"]:
        above = ErrorSite(tokens, start - 3, set())
        return above.first[0]
    return site.first[0]


def _colon(site: ErrorSite) -> Diagnostic | None:
    """Report a header without a colon."""
    if ":" not in site.expected or site.bracket:
        return None
    if site.expected != {":"} and any(token[0] == ":" for token in site.following):
        return None  # the colon exists, so the error is something before it
    span = column_after(site.before) if site.before is not None else site.span
    help = ""
    header = site.tokens[-1] if site.ends else (site.following or [site.first])[-1]
    deeper = any(token[0] == "INDENT" for token in site.tokens[: site.position + 2])
    if site.start == 0 and site.first[0] == "NAME" and header[0] != ":" and not deeper:
        help = _margin_help(site)
    return site.error(f"expected ':' {_after(site.tokens, site.position)}", help, span)


def _margin_help(site: ErrorSite) -> str:
    """Return a help for a line at the left margin that is not a header."""
    kinds = [token[0] for token in site.tokens[: site.position + 2]]
    if kinds[:2] == ["NAME", "="] or kinds[:2] == ["NAME", "NAME"]:
        return "a variable is declared under 'local:', 'allread:' or 'allwrite:'"
    return "write a statement under 'init:' or an event's 'eff:'"


def _reserved_word(site: ErrorSite) -> Diagnostic | None:
    """Report a reserved word in place of a name."""
    word = site.kind in KEYWORDS or site.kind == "GENERIC" or (site.kind == site.text and site.text.isalpha())
    if not word:
        return None
    named = site.expected == {"NAME"} or (
        "NAME" in site.expected and (site.next in ("=", "NEWLINE", "[", ")") or site.next in _AUGMENTED)
    )
    if named and not (site.kind == "GENERIC" and site.next == "["):
        help = f"'{site.text}' is a keyword of Koord; choose another name"
        return site.error(f"expected a name, found '{site.text}'", help)
    return None


def _one_formula(site: ErrorSite) -> Diagnostic | None:
    """Report a second expression under `pre:` or under the header of a property."""
    if site.expected == {"DEDENT"}:
        return site.error("a condition is one expression", "join conditions with 'and' or 'or'")
    return None


def _expected(site: ErrorSite) -> Diagnostic:
    found = f"found '{shown(site.text)}'" if site.text else f"found {_WORDS.get(site.kind, site.kind)}"
    after = f" after '{shown(site.before[1])}'" if site.before is not None and site.before[1] else ""
    help = ""
    if site.ends and site.wants_expression and site.before_is(*_OPERATORS, "=", "||", "&&", *_AUGMENTED):
        help = "a line continues after '\\', inside brackets, or if the next one begins with 'and' or 'or'"
    return site.error(f"expected {_list(site.expected)}{after}, {found}", help)


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

    The text has at most four of them.
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
