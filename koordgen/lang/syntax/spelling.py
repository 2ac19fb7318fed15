"""Errors for misspelt keywords."""

from __future__ import annotations

from collections.abc import Iterable

from koordgen.lang.diagnostics import Diagnostic
from koordgen.lang.syntax.error_site import ErrorSite, place, shown
from koordgen.lang.syntax.layout import KEYWORDS, Token

_SECTIONS = (
    "using", "param", "allread", "allwrite", "local", "def", "fun", "extern", "spec", "axiom", "invariant", "initially",
    "init", "priority", "export", "import", "provides",
)  # fmt: skip
_STATEMENTS = (
    "if", "elif", "else", "for", "while", "atomic", "return", "break", "continue", "pass", "stop",
)  # fmt: skip
_RIGHT = frozenset(("int", "float", "bool", "string", "print", "form", "list", "and", "or", "not", "in", "is"))


def misspelt_keyword(site: ErrorSite) -> Diagnostic | None:
    """Report a misspelt keyword.

    Candidates are the rejected token, the one before, the line's first, and the section's first.
    """
    tokens = site.tokens
    last = tokens[site.position]
    tries: list[tuple[Token, Iterable[str]]] = [
        (last, sorted(site.expected & (KEYWORDS | {"requires", "ensures", "guarantee"})))
    ]
    if site.before is not None and site.kind in ("NAME", "not", "forall", "exists"):
        tries.append((site.before, ("forall", "exists", "not", "in")))
    if site.start < site.position:
        tries.append((site.first, _beginning(site)))
    if {"pre", "eff"} & site.expected:
        tries.append((tokens[0], _SECTIONS))
    for token, choices in tries:
        meant = _similar_keyword(token[1], choices) if token[0] == "NAME" else ""
        if meant:
            message = f"'{shown(token[1])}' is not a keyword of Koord"
            return site.error(message, f"did you mean '{meant}'?", place(token, token))
    return None


def _beginning(site: ErrorSite) -> tuple[str, ...]:
    """Return the keywords with which the line may begin."""
    level, section = site.level(), site.tokens[0][0]
    if level == 0:
        return _SECTIONS
    if section == "using":
        return ("sensors", "actuators", "assume") if level == 1 else ()
    events = {"NAME": 0, "priority": 1}.get(section)  # the level at which events stand
    if events is not None and level <= events + 1:
        return ("pre", "eff") if level == events + 1 else ()
    return _STATEMENTS if section in ("NAME", "priority", "init", "fun", "def") else ()


def _similar_keyword(word: str, choices: Iterable[str]) -> str:
    if word in _RIGHT or len(word) > 20:
        return ""
    for choice in choices:
        if word != choice and (word.lower() == choice or _differs_by_one_slip(word, choice)):
            return choice
    return ""


def _differs_by_one_slip(word: str, meant: str) -> bool:
    """Return whether a word differs by two swapped letters, or by one wrong, missing or extra letter.

    In short words fewer differences count, because they resemble too many other words.
    """
    if len(word) == len(meant):
        wrong = [i for i in range(len(word)) if word[i] != meant[i]]
        if len(wrong) == 1:
            return len(word) > 3
        return len(wrong) == 2 and word[wrong[0]] == meant[wrong[1]] and word[wrong[1]] == meant[wrong[0]]
    short, long = sorted((word, meant), key=len)
    return (
        len(long) - len(short) == 1
        and len(short) > 2
        and any(short == long[:i] + long[i + 1 :] for i in range(len(long)))
    )
