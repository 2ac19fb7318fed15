"""Errors for characters and operators that Koord lacks, with the form that Koord has."""

from __future__ import annotations

import re
from collections.abc import Callable

from koordgen.lang.diagnostics import Diagnostic
from koordgen.lang.syntax.error_site import ErrorSite, place, shown

_CHARACTERS = {
    ";": "write each statement on a line of its own, without ';'",
    "&": "write 'and'",
    "|": "write 'or'",
    "~": "write 'not'",
    "?": "write 'a if condition else b'",
    "^": "a power is written '**'",
    "\u201c": 'write a string in straight quotes: "..."',
    "\u201d": 'write a string in straight quotes: "..."',
    "\u2018": "write a string in straight quotes: '...'",
    "\u2019": "write a string in straight quotes: '...'",
    "\u2013": "write '-'",
    "\u2212": "write '-'",
    "\u00d7": "write '*'",
    "\u00b7": "write '*'",
    "\u2264": "write '<='",
    "\u2265": "write '>='",
    "\u2260": "write '!='",
    "\u2192": "write '->'",
    "\u2227": "write 'and'",
    "\u2228": "write 'or'",
    "\u00ac": "write 'not'",
    "\u2200": "write 'forall'",
    "\u2203": "write 'exists'",
    "\u2208": "write 'in'",
    "\u00a0": "write an ordinary space",
    "\\": "a '\\' that continues a line must be its last character",
}


def _character(site: ErrorSite) -> Diagnostic | None:
    if site.kind != "BAD":
        return None
    text = site.text
    if text[0].isdigit() and text[0].isascii():
        return _number(site)
    if text.isalpha():
        help = "a name is made of the letters a to z and A to Z, digits and '_'"
    else:
        help = _CHARACTERS.get(text, "")
    known = (text.isprintable() and text.isascii()) or text.isalpha()
    name = f"'{text}'" if known else f"'{text}' (U+{ord(text):04X})" if text.isprintable() else f"'U+{ord(text):04X}'"
    return site.error(f"unexpected character {name}", help, code="K002")


def _number(site: ErrorSite) -> Diagnostic:
    text = site.text
    help = ""
    if re.fullmatch(r"[0-9][0-9_]*(\.[0-9_]*)?", text):
        help = f"write {shown(text.replace('_', ''))}"
    elif re.fullmatch(r"0[xX][0-9a-fA-F]{1,15}|0[oO][0-7]{1,20}|0[bB][01]{1,60}", text):
        help = f"write {int(text, 0)}"
    elif re.fullmatch(r"[0-9.]+[fFdDlLuU]", text):
        help = f"write {shown(text[:-1])}"
    elif re.fullmatch(r"[0-9]+[A-Za-z_][A-Za-z0-9_]*", text):
        help = "a name does not begin with a digit"
    return site.error(f"'{shown(text)}' is not a number", help)


def _quotes(site: ErrorSite) -> Diagnostic | None:
    """Report string prefixes, adjacent strings and multi-line strings.

    The quote of `f'...'` may have been read as a prime.
    """
    before, head = site.before, site.head
    if before is None:
        return None
    prefix = None
    if site.kind == "STRING" and site.touches("NAME"):
        prefix = before
    elif before[0] == "'" and len(head) > 1 and head[-2][0] == "NAME" and head[-2][1].lower() in ("f", "r", "b", "u"):
        prefix = head[-2]
    if prefix is not None and prefix[1].lower() in ("f", "fr", "rf"):
        return site.error("Koord has no f-strings", "join strings: 'at ' + str(x)", place(prefix, before))
    if prefix is not None:
        return site.error("a string has no prefix before its quotes", span=place(prefix, before))
    if site.kind == "STRING" and before[0] == "STRING":
        if before[1] in ('""', "''"):
            return site.error("a string must be on one line", "a comment begins with '#'", place(before, before))
        return site.error("two strings follow each other", "join them with '+'")
    return None


def _points(site: ErrorSite) -> Diagnostic | None:
    """Report numbers such as `1.`, and ranges of other languages (`1..3`, `1 to 3`)."""
    dots = site.before_is(".") and site.text[:1] == "."
    if site.first[0] == "for" and (dots or site.text in ("to", "until", "downto")):
        return site.error(f"expected ',' or ':', found '{site.text}'", "write 'for i in range(a, b):'")
    if site.before_is(".") and not dots and len(site.head) > 1 and site.head[-2][0] == "INT":
        first, dot = site.head[-2:]
        return site.error(f"'{shown(first[1])}.' is not a number", f"write {shown(first[1])}.0", place(first, dot))
    return None


def _marks(site: ErrorSite) -> Diagnostic | None:
    """Report operators of other languages that are read as two of Koord's: `++`, `<>`, `=>`, `:=`."""
    head = site.head
    for mark in ("+", "-"):
        doubled = len(head) > 1 and head[-1][0] == head[-2][0] == mark and head[-1][3] == head[-2][3] + 1
        if doubled and (site.ends or site.kind == ")"):
            return _step(site, mark, head[-3][1] if len(head) == 3 and head[-3][0] == "NAME" else "x")
        if site.kind == mark and site.touched_by(mark):
            operand = site.following[1][1] if len(site.following) > 1 and site.following[1][0] == "NAME" else "x"
            return _step(site, mark, operand)
        if site.kind == mark == "+" and site.touches("+"):
            operand = head[0][1] if len(head) == 2 and head[0][0] == "NAME" else "x"
            return _step(site, mark, operand)
    pair = f"{site.before[1]}{site.text}" if site.before is not None and site.touches(site.before[0]) else ""
    ours = {"<>": "!=", "===": "==", "!==": "!=", "=<": "<=", "=>": ">="}.get(pair)
    if ours is None and site.kind == "=" and site.touched_by(">"):
        pair, ours = "=>", ">="
    elif ours is None and site.kind == "=" and site.touched_by("<"):
        pair, ours = "=<", "<="
    if ours is None and site.kind == ":" and site.touched_by("="):
        pair, ours = ":=", "="
    if ours is None and site.kind == ":" and site.touched_by(":") and site.before_is("NAME"):
        pair, ours = "::", "."
    if ours is None and site.kind == "->" and "." in site.expected:
        pair, ours = "->", "."
    if ours is not None:
        return site.error(f"Koord has no '{pair}'", f"write '{ours}'")
    if site.kind == "+" and site.wants_expression:
        return site.error("a value cannot have a '+' before it", "remove the '+'")
    if site.kind in ("//", "/") and ("pass" in site.expected or site.position == 0):
        return site.error(f"a line cannot begin with '{site.kind}'", "a comment begins with '#'")
    if site.kind == "NAME" and any(token[0] == "//" for token in site.head) and not site.touches("//"):
        return site.error(f"expected an operator, found '{shown(site.text)}'", "a comment begins with '#'")
    return None


def _step(site: ErrorSite, mark: str, operand: str) -> Diagnostic:
    return site.error(f"Koord has no '{mark}{mark}'", f"write {shown(operand)} {mark}= 1")


# Tried in this order; the first diagnostic is reported.
MARKS: tuple[Callable[[ErrorSite], Diagnostic | None], ...] = (_character, _quotes, _points, _marks)
