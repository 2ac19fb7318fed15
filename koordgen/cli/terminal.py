"""A line on a terminal that is written over, again and again; nothing where there is no terminal."""

from __future__ import annotations

import shutil
from typing import TextIO


class Line:
    """Shows the newest text only, as much of it as the terminal is wide."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._shown = False

    def show(self, text: str) -> None:
        if self._stream.isatty():
            width = shutil.get_terminal_size().columns
            self._shown = True  # before it is: an interrupt may come in between
            self._stream.write(f"\r\x1b[K{text[: max(20, width - 1)]}")
            self._stream.flush()

    def end(self) -> None:
        """What comes next is another line."""
        if self._shown:
            self._stream.write("\n")
            self._shown = False
