"""Small replicated stores and closings for tests."""

from __future__ import annotations

from typing import Any

import msgspec

from koordgen.runtime.net.layout import Layout
from koordgen.runtime.net.ledger import Ledger
from koordgen.runtime.net.wire import Closing, View, Write
from koordgen.runtime.program.program import Variable
from koordgen.runtime.replication.log import Log
from koordgen.runtime.replication.memory import Memory
from koordgen.runtime.values.bounds import Fixed

SHARED = (
    Variable("x", "allread", int, Fixed(9), lambda: 0),
    Variable("last", "allwrite", int, Fixed(9), lambda: -1),
)


def layout(n: int = 3) -> Layout:
    return Layout(SHARED, n)


def view(n: int = 3) -> View:
    return View(0, 1, (0,) * n)


def fleet(n: int = 3) -> list[Memory]:
    inits = [Closing(pid, 0, 0, 0) for pid in range(n)]
    return [Memory.begin(layout(n), pid, view(n), inits) for pid in range(n)]


def log_of(pid: int, n: int = 3) -> Log:
    """One that no memory looks at."""
    return Log(Ledger(0, n), pid)


def write(index: int, value: Any) -> Write:
    return Write(index, msgspec.Raw(msgspec.msgpack.encode(value)))


def one(author: int, round_: int, *writes: Write, incarnation: int = 0, lock: int = -1, **more: Any) -> Closing:
    return Closing(author, incarnation, round_, round_, acted=True, lock=lock, writes=writes, **more)


def silence(author: int, first: int, round_: int, incarnation: int = 0, stopped: bool = False) -> Closing:
    return Closing(author, incarnation, first, round_, stopped)


def give(memory: Memory, *closings: Closing, present: int = 20) -> list[str | None]:
    return [memory.take(c, present) for c in closings]


def said(memory: Memory, pid: int, applied: int, number: int = 0, through: int = 0, asks: bool = False) -> str | None:
    n = len(memory.view.members)
    return memory.heard(pid, number, applied, (applied,) * n, through, 0, 50, asks)


def everything(memory: Memory) -> Any:
    return memory.applied, memory.shared, memory.stopped, memory.acted
