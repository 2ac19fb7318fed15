"""Terminal output: a progress line that is overwritten, and colours for errors and verdicts."""

from __future__ import annotations

import os
import re
import shutil
from typing import TextIO

_RED, _GREEN, _YELLOW, _CYAN = "1;31", "1;32", "1;33", "1;36"
_NAMES = ("36", "33", "32", "35", "34", "96", "93", "92", "95", "94")
_COLOURS = {
    "error": _RED, "warning": _YELLOW, "note": _CYAN, "help": _CYAN,
    "PROVED": _GREEN, "HELD": _GREEN, "HOLDS": _GREEN, "VALIDATED": _GREEN, "held": _GREEN,
    "FALSIFIED": _RED, "NOT INDUCTIVE": _RED, "VIOLATED": _RED, "UNSOUND": _RED, "violated": _RED,
    "UNKNOWN": _YELLOW, "VACUOUS": _YELLOW, "INCONCLUSIVE": _YELLOW,
}  # fmt: skip
# The pattern also matches the text before the word, which stays as it is.
_KINDS = re.compile(r"(?m)^(.*?:\d+:\d+: | *= |  )?(error|warning|note|help)(?=(?:\[\w+\])?:)")
_CARETS = re.compile(r"(?m)^( *\| *)(\^+)")
_VERDICTS = re.compile(
    r"(?m)(^|\b)(PROVED|HELD|HOLDS|VALIDATED|FALSIFIED|NOT INDUCTIVE|VIOLATED|UNSOUND|UNKNOWN|VACUOUS|INCONCLUSIVE|"
    r"(?<![^\n])held|(?<![^\n])violated)\b"
)


class ProgressLine:
    """Progress line: shows the latest text only, cut to the width of the terminal."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._shown = False

    def show(self, text: str) -> None:
        if self._stream.isatty():
            width = shutil.get_terminal_size().columns
            self._shown = True  # set before writing, since an interrupt may come in between
            self._stream.write(f"\r\x1b[K{text[: max(20, width - 1)]}")
            self._stream.flush()

    def end(self) -> None:
        """End the line: further output begins in a new line."""
        if self._shown:
            self._stream.write("\n")
            self._shown = False


def has_colours(stream: TextIO) -> bool:
    """Return whether a stream is a terminal whose user wants colours (https://no-color.org)."""
    return stream.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


def coloured_message(text: str, stream: TextIO) -> str:
    """Colour the kind of a message and the marks below its source line, if the stream supports colours."""
    if not has_colours(stream):
        return text
    return _CARETS.sub(_word, _KINDS.sub(_word, text))


def coloured_verdicts(text: str, stream: TextIO) -> str:
    """Colour the verdicts of a report, if the stream supports colours."""
    return _VERDICTS.sub(_word, text) if has_colours(stream) else text


def coloured_name(name: str, index: int, stream: TextIO) -> str:
    """Colour a robot's name by its index in the fleet, if the stream supports colours."""
    return f"\x1b[{_NAMES[index % len(_NAMES)]}m{name}\x1b[0m" if has_colours(stream) else name


def _word(found: re.Match[str]) -> str:
    return f"{found[1] or ''}\x1b[{_COLOURS.get(found[2], _RED)}m{found[2]}\x1b[0m"
