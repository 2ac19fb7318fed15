"""Where a space stands between two neighbouring tokens of one statement."""

from __future__ import annotations

from koordgen.lang.syntax.layout import GENERICS, KEYWORDS

_OPENING = frozenset("([{")
_CLOSING = frozenset(")]}")
_OPERATORS = frozenset(
    (
        "+", "-", "*", "/", "//", "%", "**", "<<", "==", "!=", "<", "<=", ">", ">=", "=", "+=", "-=", "*=", "/=",
        "//=", "%=", "**=", "->", "&&", "||", "!", ".", ",", ":",
    )
)  # fmt: skip
_NO_VALUES = (KEYWORDS - {"True", "False"}) | _OPERATORS | _OPENING

# The open bracket is the index of a value, or the type arguments of a generic type.
INDEX, TYPES = "x[", "<"


class Spacer:
    """Takes the tokens of one statement in order. `brackets` are those that are open, outermost first."""

    def __init__(self) -> None:
        self.brackets: list[str] = []
        self._last = ""
        self._after_value = False  # the last token ends a value (or a type or a name)
        self._tight = True  # nothing may stand between the last token and the next one

    def take(self, token: str) -> bool:
        """Whether a space stands before this token."""
        closes_types = token == ">" and self._inside(TYPES)
        unary = token == "!" or (token == "-" and not self._after_value)
        space = not self._tight and not self._clings(token, closes_types)
        tight = unary or token in _OPENING or token == "."
        if token in _CLOSING or closes_types:
            self._close(closes_types)
        elif token == "<" and self._last in GENERICS:
            self.brackets.append(TYPES)
            tight = True
        elif token in _OPENING:
            self.brackets.append(INDEX if token == "[" and self._after_value else token)
        elif (token == ":" and self._inside(INDEX)) or (token == "=" and self._inside("(")):
            tight = True
        # Behind a declared name, `max` is a word of the language, and what follows it is no argument.
        capacity = token == "max" and self._after_value
        self._after_value = closes_types or not (token in _NO_VALUES or capacity)
        self._last, self._tight = token, tight
        return space

    def _clings(self, token: str, closes_types: bool) -> bool:
        """Whether this token follows the last one without a space."""
        if token in _CLOSING or token in (",", ".", ":", "'") or closes_types:
            return True
        if token in ("(", "["):
            return self._after_value
        if token == "<":
            return self._last in GENERICS
        return token == "=" and self._inside("(")

    def _inside(self, bracket: str) -> bool:
        return bool(self.brackets) and self.brackets[-1] == bracket

    def _close(self, types: bool) -> None:
        while not types and self._inside(TYPES):  # a generic word without its `>`
            self.brackets.pop()
        if self.brackets:
            self.brackets.pop()
