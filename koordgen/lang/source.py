"""Source text of a program, and spans in it, which diagnostics refer to."""

from __future__ import annotations

from bisect import bisect_right

from koordgen.lang.node import Node


class Span(Node):
    """Half-open range of a source text, in 1-based lines and columns. Columns count characters."""

    line: int
    column: int
    end_line: int
    end_column: int


class Source:
    """Source text with its path as the user wrote it.

    `\\r\\n` is replaced by `\\n`; a byte order mark is removed.
    """

    def __init__(self, path: str, text: str) -> None:
        self.path = path
        self.text = text.removeprefix("\ufeff").replace("\r\n", "\n")
        self._starts: list[int] | None = None

    def _line_starts(self) -> list[int]:
        if self._starts is None:
            starts = self._starts = [0]
            while end := self.text.find("\n", starts[-1]) + 1:
                starts.append(end)
        return self._starts

    def line(self, number: int) -> str:
        """Return the text of a 1-based line without its line end; empty beyond the last line."""
        starts = self._line_starts()
        if not 1 <= number <= len(starts):
            return ""
        end = starts[number] - 1 if number < len(starts) else len(self.text)
        return self.text[starts[number - 1] : end]

    def span(self, start: int, end: int) -> Span:
        """Return the span of the character offsets [start, end)."""
        starts = self._line_starts()
        first = bisect_right(starts, start) - 1
        last = bisect_right(starts, end) - 1
        return Span(first + 1, start - starts[first] + 1, last + 1, end - starts[last] + 1)
