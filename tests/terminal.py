"""A serial device whose other end is ours."""

from __future__ import annotations

import os
import pty
import signal
import tty
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def terminal(seconds: int = 30) -> Iterator[tuple[int, str]]:
    """Our end, and the path of the device. What takes longer than that many seconds with it hangs, and is ended."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    before = signal.signal(signal.SIGALRM, _hung)
    try:
        signal.alarm(seconds)
        yield master, os.ttyname(slave)
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
        os.close(master)
        os.close(slave)


class Hung(BaseException):
    """Nothing that is tested catches it, and it ends one test, not all."""


def _hung(number: int, frame: object) -> None:
    raise Hung
