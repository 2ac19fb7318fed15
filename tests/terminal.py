"""Pseudo terminal as a serial device, whose other end is in the test."""

from __future__ import annotations

import os
import pty
import signal
import tty
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def terminal(seconds: int = 30) -> Iterator[tuple[int, str]]:
    """Yield our end and the path of the device. A test that takes longer than so many seconds is ended."""
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
    """Raised in a test that hangs. Tested code does not catch it, and other tests continue."""


def _hung(number: int, frame: object) -> None:
    raise Hung
